"""Tables and sentences of the results page, each made from the JSON of results; nothing here knows a result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path

from learning.accuracy.page import over_seeds
from learning.accuracy.report import CLOCK, MAJORITY, ORACLE
from learning.figures.charts import headline, known
from learning.figures.style import title_of
from learning.methods.table import METHODS
from learning.reproduce.made import Json, made_of, read, seed_of
from learning.reproduce.presets import PRESETS
from learning.value_maps.page import PAPER as PAPER_RANKING
from learning.value_maps.report import ANOTHER, ONE_SIMULATION, VIEW_ORACLE_MAP


@dataclass
class Findings:
    """Everything that a reproduction's folder holds for the page; `docs/`, where one is published, holds as much.

    Args:
        folder: with `results/` and `figures/`.
        preset: its groups say what stands beside their figures.
    """

    folder: Path
    preset: str = ""

    def caveat(self, group: str, method: str) -> str:
        """Return what stands beside a method's figures, where it is of a group."""
        groups = PRESETS[self.preset].groups if self.preset in PRESETS else ()
        return next((dict(each.caveats).get(method, "") for each in groups if each.name == group), "")

    def networks(self, group: str, method: str) -> str:
        """Return which networks a figure is of: group, samples, games and seeds, with what is to be said of them."""
        cards = [card for stem, card in self.cards.get(group, {}).items() if stem.startswith(f"{method}-seed")]
        card = self.card(group, method)
        samples, games = card.get("training", {}).get("samples"), card.get("data", {}).get("episodes", {}).get("train")
        text = f"`{group}`" + (f": {samples:,} samples of {games:,} games" if samples and games else "")
        seeds = ", ".join(dict.fromkeys(seed_of(each) for each in cards or [card]))
        text += f", {'seeds' if len(cards) > 1 else 'seed'} {seeds}" if seeds else ""
        return "; ".join(part for part in (text, self.caveat(group, method)) if part)

    @cached_property
    def made(self) -> Json:
        """How the results were made: see `learning.reproduce.made`."""
        return made_of(self.folder)

    @property
    def stages(self) -> dict[str, Json]:
        return self.made.get("stages", {})

    @property
    def cards(self) -> dict[str, dict[str, Json]]:
        """Model cards by group and file stem."""
        return self.made.get("weights", {})

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

    def _more(self, prefix: str) -> dict[str, Json]:
        paths = sorted((self.folder / "results").glob(f"{prefix}*.json"))
        return {path.stem.removeprefix(prefix): read(path) for path in paths}

    def card(self, group: str, method: str) -> Json:
        """Return the card of a method's network, of the first seed; empty where there is none."""
        cards, stem = self.cards.get(group, {}), "vpt-tob" if method == "caught-head" else method
        return cards.get(stem) or next((card for name, card in cards.items() if name.startswith(f"{stem}-seed")), {})

    def judged_for(self, method: str, reports: dict[str, Json], first: Json) -> list[tuple[str, Json]]:
        """Return groups and reports that tell of a method: that of Table I, and that whose network saw most samples of games like
        the main ones."""
        seen = {}
        for group, report in {self.compared: first, **reports}.items():
            if method not in (report.get("methods") or report.get("weights") or {}):
                continue
            card = self.card(group, method)
            learnt, judged = card.get("data", {}), self.accuracy["data"]
            if all(sorted(learnt.get(key, ())) == sorted(judged[key]) for key in ("seekers", "layouts", "horizons")):
                seen[group] = card.get("training", {}).get("samples") or 0
        largest = [max(seen, key=lambda name: seen[name])] if seen else []
        asked = dict.fromkeys([*([self.compared] if self.compared in seen else []), *largest])
        return [(group, {self.compared: first, **reports}[group]) for group in asked]

    @property
    def compared(self) -> str:
        """Name of the group of Table I: the one whose weights its results name."""
        digests = {seen["sha256"] for found in self.accuracy["methods"].values() for seen in found["weights"].values()}
        return next((name for name, cards in self.cards.items() if digests & {c.get("sha256") for c in cards.values()}), "")


def daggers(found: Findings, reports: dict[str, Json]) -> list[str]:
    """Return a line on the networks of some reports whose figures are marked with a dagger, followed by an empty one.

    Args:
        reports: by group.
    """
    marked: dict[str, list[str]] = {}
    for group, report in reports.items():
        for method in report.get("methods") or report.get("weights") or {}:
            if caveat := found.caveat(group, method):
                marked.setdefault(caveat, []).append(f"{title_of(method)}, `{group}`")
    return [line for caveat, names in marked.items() for line in (f"† {'; '.join(names)}: {caveat}.", "")]


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
    seeded = any("over seeds" in found for found in main["methods"].values())
    head = ["", "the paper, %"]
    head += [f"{few_set['examples']:,} examples, %"] if few_set else []
    head += [f"{main['examples']:,} examples, % [95 % over games]", *(["over training seeds, points"] if seeded else [])]
    head += ["balanced, %", "AUROC", "ECE, points", "over horizon only, points"]
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
        row += [accuracy_of(found), *([over_seeds(found.get("over seeds"))] if seeded else [])]
        row += [percent(found["balanced accuracy"]), "" if found["AUROC"] is None else f"{found['AUROC']:.3f}"]
        row += [percent(found["calibration"]["expected calibration error"]), over(found, CLOCK)]
        row += [_accuracy(first, name)] if first else []
        rows.append(row)
    return markdown(head, rows)


def accuracy_of(found: Json) -> str:
    """Return an accuracy, %, with its interval over games."""
    return f"{percent(found['accuracy'])} {interval(found['accuracy interval 95 %'])}"


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


def table_two(found: Findings, value: str, measure: str, with_paper: bool) -> list[str]:
    """Return relative ranking accuracy by T, mean and standard deviation over maps, with the change from the first T.

    Args:
        value: how a network's answers are added up to a map: `binary` or `expected`.
        measure: `with_ties` or `without_ties`.
    """
    reports = {found.compared: found.maps, **found.maps_of_groups}
    first = found.maps
    horizons = [str(steps) for steps in first["horizons"]]
    change = len(horizons) > 1
    head = ["value map", *(f"T = {steps}, %" for steps in horizons)]
    head += [f"{horizons[0]} to {horizons[-1]}, points [95 %]"] if change else []
    rows = []
    if with_paper:
        paper = [PAPER_RANKING.get(int(steps)) for steps in horizons]
        row = ["*the paper, VPT-TOB*", *("" if found is None else "{:.2f} ± {:.2f}".format(*found) for found in paper)]
        ends = (paper[0], paper[-1])
        row += ["" if None in ends else f"{ends[1][0] - ends[0][0]:+.2f}"] if change else []  # type: ignore[index]
        rows.append(row)
    shown = set[str]()
    for group, report in reports.items():
        ranking = report["ranking"]
        for name in ranking[horizons[0]][ONE_SIMULATION]:
            method, _, its = name.rpartition(", ")
            network = method in METHODS
            if (its != value) if network else (name in shown):
                continue
            shown.add(name)
            cells = [ranking[steps][ONE_SIMULATION][name][measure] for steps in horizons]
            mark = " †" if found.caveat(group, method) else ""
            row = [f"{title_of(method)}, `{group}`{mark}" if network else name, *map(_share, cells)]
            if change:
                last = cells[-1].get("change since the first horizon", {"mean": None})
                row.append(
                    "" if last["mean"] is None else f"{100 * last['mean']:+.1f} {interval(last['interval 95 %'], signed=True)}"
                )
            rows.append(row)
    return markdown(head, rows)


def _share(found: Json) -> str:
    if found["mean"] is None:
        return ""
    seeds = f"; seeds {over_seeds(found['over seeds'])}" if "over seeds" in found else ""
    return f"{percent(found['mean'])} ± {percent(found['sd'] or 0)}{seeds}"


def played(findings: Findings) -> list[str]:
    """Return how a hider fares that follows each map, at the first T; networks by their summed probabilities."""
    reports = {findings.compared: findings.maps, **findings.maps_of_groups}
    steps = str(findings.maps["horizons"][0])
    fared: dict[str, Json] = {}
    for group, report in reports.items():
        for name, found in report["play"][steps].items():
            method, _, value = name.rpartition(", ")
            if method in METHODS and value == "expected":
                fared[f"{title_of(method)}, `{group}`{' †' if findings.caveat(group, method) else ''}"] = found
            elif method not in METHODS:
                fared.setdefault(name, found)
    rows = []
    for title, found in sorted(fared.items(), key=lambda item: -item[1]["survival"]["mean"]):
        survival, value = found["survival"], found["V"]
        low, high = survival["interval 95 %"]
        seeds = survival.get("over seeds")
        spread = f"; {seeds['n']} seeds ±{seeds['sd']:.0f}" if seeds else ""
        caught = percent(found["caught by T"]["mean"])
        rows.append([title, f"{survival['mean']:.0f} [{low:.0f}, {high:.0f}]{spread}", f"{value['mean']:.2f}", caught])
    return markdown(["goal chosen by", f"steps free, of {steps} [95 %]", "danger V", "caught, %"], rows)


def best_tie_free(report: Json, method: str) -> Json | None:
    """Return the tie-free relative ranking accuracy of a method's summed probabilities, or of what simulation says."""
    ranking = report["ranking"][str(report["horizons"][0])][ONE_SIMULATION]
    found = ranking.get(method if method in (ANOTHER, VIEW_ORACLE_MAP) else f"{method}, expected")
    return None if found is None else found["without_ties"]
