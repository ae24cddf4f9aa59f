"""Tables and sentences of the results page, each made from the JSON of results; nothing here knows a result."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

from learning.accuracy.report import CLOCK, MAJORITY, ORACLE
from learning.figures.charts import headline, known
from learning.figures.style import title_of
from learning.methods.table import METHODS
from learning.value_maps.page import PAPER as PAPER_RANKING
from learning.value_maps.report import ANOTHER, ONE_SIMULATION, VIEW_ORACLE_MAP

Json = dict[str, Any]


def read(path: Path) -> Json:
    """Return a file's JSON; empty where there is none."""
    return json.loads(path.read_text()) if path.is_file() else {}


@dataclass
class Findings:
    """Everything that a reproduction's folder holds for the page."""

    folder: Path
    stamps: dict[str, Json] = field(init=False)

    def __post_init__(self) -> None:
        self.stamps = {path.stem: read(path) for path in sorted((self.folder / "stamps").glob("*.json"))}

    @cached_property
    def accuracy(self) -> Json:
        return read(self.folder / "results/accuracy.json")

    @cached_property
    def maps(self) -> Json:
        return read(self.folder / "results/maps.json")

    @cached_property
    def of_groups(self) -> dict[str, Json]:
        """Accuracy of other groups of networks, by group."""
        return self._more("accuracy-of-")

    @cached_property
    def maps_of_groups(self) -> dict[str, Json]:
        return self._more("maps-of-")

    @cached_property
    def of_kinds(self) -> dict[str, Json]:
        """Accuracy of the compared networks on other kinds of data, by kind."""
        found = self._more("accuracy-")
        return {name: report for name, report in found.items() if not name.startswith("of-")}

    @cached_property
    def cards(self) -> dict[str, dict[str, Json]]:
        """Model cards by group and file stem."""
        folders = sorted(path for path in (self.folder / "weights").glob("*") if path.is_dir())
        return {folder.name: {path.stem: read(path) for path in sorted(folder.glob("*.json"))} for folder in folders}

    def _more(self, prefix: str) -> dict[str, Json]:
        paths = sorted((self.folder / "results").glob(f"{prefix}*.json"))
        return {path.stem.removeprefix(prefix): read(path) for path in paths}

    def largest(self, method: str, reports: dict[str, Json], first: Json) -> tuple[str, Json] | None:
        """Return group ("" = the compared) and report of the network of a method that saw most samples of games like the main
        ones."""
        seen = {}
        for group, report in {"": first, **reports}.items():
            if not report or method not in report.get("methods", report.get("weights", {})):
                continue
            card = self.cards.get(group or self.compared, {}).get(method, {})
            learnt, judged = card.get("data", {}), self.accuracy["data"]
            if all(sorted(learnt.get(key, ())) == sorted(judged[key]) for key in ("seekers", "layouts", "horizons")):
                seen[group] = card.get("training", {}).get("samples") or 0
        if not seen:
            return None
        group = max(seen, key=lambda name: seen[name])
        return group, reports[group] if group else first

    @property
    def compared(self) -> str:
        """Name of the group of Table I: the one whose weights its results name."""
        digests = {seen["sha256"] for found in self.accuracy["methods"].values() for seen in found["weights"].values()}
        return next((name for name, cards in self.cards.items() if digests & {c.get("sha256") for c in cards.values()}), "")


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table."""
    lines = ["| " + " | ".join(row) + " |" for row in (head, *rows)]
    return [lines[0], "|" + "---|" * len(head), *lines[1:]]


def percent(value: float | None, digits: int = 1) -> str:
    return "" if value is None else f"{100 * value:.{digits}f}"


def interval(bounds: Sequence[float | None], signed: bool = False) -> str:
    form = "{:+.1f}" if signed else "{:.1f}"
    return "" if None in bounds else "[" + ", ".join(form.format(100 * bound) for bound in bounds if bound is not None) + "]"


def over(found: Json, reference: str) -> str:
    """Return the paired difference to a reference, points, with its interval."""
    against = found["against"].get(reference)
    return "" if against is None else f"{100 * against['difference']:+.1f} {interval(against['interval 95 %'], signed=True)}"


def set_of(report: Json, start: str, limit: int, examples: int | None = None) -> Json | None:
    """Return one set of examples: the largest, where no size is given."""
    sets = [found for found in report["results"] if found["start"] == start and found["horizon limit"] == limit]
    sets = [found for found in sets if examples is None or found["examples"] == examples]
    return max(sets, key=lambda found: found["examples"]) if sets else None


def table_one(report: Json) -> list[str]:
    """Return Table I: the paper's figure beside ours, for the paper's number of examples and for more."""
    main = headline(report)
    limit = main["horizon limit"]
    few = min((found for found in report["results"] if found["horizon limit"] == limit), key=lambda found: found["examples"])
    few_set = set_of(report, "uniform", limit, few["examples"]) if few["examples"] < main["examples"] else None
    first = set_of(report, "first", limit)
    head = ["", "the paper, %"]
    head += [f"{few_set['examples']:,} examples, %"] if few_set else []
    head += [f"{main['examples']:,} examples, % [95 %]", "balanced, %", "AUROC", "ECE, points", "over horizon only, points"]
    head += ["t0 = 0, %"] if first else []
    rows = []
    for name in [MAJORITY, CLOCK, *known(main["methods"]), ORACLE]:
        found = main["methods"].get(name)
        if found is None:
            continue
        paper = METHODS[name].paper if name in METHODS else None
        fewer = f" (the first {found['examples']:,} examples only)" if found["examples"] < main["examples"] else ""
        row = [title_of(name) + fewer, percent(paper, 2)]
        row += [_accuracy(few_set, name)] if few_set else []
        row += [f"{percent(found['accuracy'])} {interval(found['accuracy interval 95 %'])}", percent(found["balanced accuracy"])]
        row += ["" if found["AUROC"] is None else f"{found['AUROC']:.3f}"]
        row += [percent(found["calibration"]["expected calibration error"]), over(found, CLOCK)]
        row += [_accuracy(first, name)] if first else []
        rows.append(row)
    return markdown(head, rows)


def _accuracy(result: Json, name: str) -> str:
    return percent(result["methods"].get(name, {}).get("accuracy"))


def ordering(report: Json) -> list[str]:
    """Return how the order of the paper's methods came out here, and for each pair that is the other way round, by how much."""
    main = headline(report)["methods"]
    ours = {name: main[name]["accuracy"] for name in known(main) if METHODS[name].paper is not None}
    papers = {name: METHODS[name].paper or 0.0 for name in ours}
    if len(ours) < 2:
        return []

    def said(values: dict[str, float]) -> str:
        named = [f"{title_of(name)} ({percent(values[name], 2)})" for name in sorted(values, key=lambda name: -values[name])]
        return ", ".join(named)

    lines = [f"* The paper's order, best first: {said(papers)}. (It has one coordinate-value baseline; ours has two variants.)"]
    lines.append(f"* Ours, best first: {said(ours)}.")
    turned = [
        (first, second)
        for first, second in combinations(ours, 2)
        if (papers[first] - papers[second]) * (ours[first] - ours[second]) < 0
    ]
    if not turned:
        lines.append("* No pair of methods comes out the other way round than in the paper.")
    for first, second in turned:
        better, worse = (first, second) if ours[first] > ours[second] else (second, first)
        text = f"* Other than in the paper: {title_of(better)} is {100 * (ours[better] - ours[worse]):.1f} points above"
        lines.append(
            f"{text} {title_of(worse)} (paper: {100 * (papers[better] - papers[worse]):+.1f}){_certainty(main, better, worse)}."
        )
    return lines


def _certainty(main: Json, better: str, worse: str) -> str:
    """Return whether a difference could be chance, where it was measured in pairs."""
    for one, other in ((better, worse), (worse, better)):
        against = main[one]["against"].get(other)
        if against:
            low, high = against["interval 95 %"]
            return "; the 95 % interval of the difference includes 0" if low <= 0 <= high else "; the 95 % interval excludes 0"
    return ""


def table_two(report: Json, measure: str, with_paper: bool) -> list[str]:
    """Return relative ranking accuracy by T, mean and standard deviation over maps, with the change from the first T."""
    horizons = [str(steps) for steps in report["horizons"]]
    ranking = report["ranking"]
    change = len(horizons) > 1
    head = ["value map", *(f"T = {steps}, %" for steps in horizons)]
    head += [f"{horizons[0]} to {horizons[-1]}, points"] if change else []
    rows = []
    if with_paper:
        paper = [PAPER_RANKING.get(int(steps)) for steps in horizons]
        row = ["*the paper, VPT-TOB, binary*", *("" if found is None else "{:.2f} ± {:.2f}".format(*found) for found in paper)]
        ends = (paper[0], paper[-1])
        row += ["" if None in ends else f"{ends[1][0] - ends[0][0]:+.2f}"] if change else []  # type: ignore[index]
        rows.append(row)
    for name in ranking[horizons[0]][ONE_SIMULATION]:
        cells = [ranking[steps][ONE_SIMULATION][name][measure] for steps in horizons]
        row = [_map_name(name)]
        row += ["" if c["mean"] is None else f"{percent(c['mean'])} ± {percent(c['sd'] or 0)}" for c in cells]
        if change:
            last = cells[-1].get("change since the first horizon", {"mean": None})
            row.append(
                "" if last["mean"] is None else f"{100 * last['mean']:+.1f} {interval(last['interval 95 %'], signed=True)}"
            )
        rows.append(row)
    return markdown(head, rows)


def _map_name(name: str) -> str:
    method, _, value = name.rpartition(", ")
    return f"{title_of(method)}, {value}" if method in METHODS else name


def played(report: Json) -> list[str]:
    """Return how a hider fares that follows each map, at the first T."""
    steps = str(report["horizons"][0])
    rows = []
    for name, found in sorted(report["play"][steps].items(), key=lambda item: -item[1]["survival"]["mean"]):
        survival, value = found["survival"], found["V"]
        low, high = survival["interval 95 %"]
        rows.append(
            [
                _map_name(name),
                f"{survival['mean']:.0f} [{low:.0f}, {high:.0f}]",
                f"{value['mean']:.2f}",
                percent(found["caught by T"]["mean"]),
            ]
        )
    return markdown(["goal chosen by", f"steps free, of {steps} [95 %]", "V (lower is safer)", "caught, %"], rows)


def best_tie_free(report: Json, method: str) -> Json | None:
    """Return the tie-free relative ranking accuracy of a method's summed probabilities, or of what simulation says."""
    ranking = report["ranking"][str(report["horizons"][0])][ONE_SIMULATION]
    found = ranking.get(method if method in (ANOTHER, VIEW_ORACLE_MAP) else f"{method}, expected")
    return None if found is None else found["without_ties"]
