"""`vantage reproduce page`: the results page of a reproduction, written from the JSON that its stages left.

Every sentence with a number in it is made from results. Levers that were tried are read from docs/experiments/*.json:

    {"title": "...", "why": "...", "table": [{"column": "value", ...}, ...], "found": "...", "provenance": {...}}
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from learning.accuracy.report import CLOCK, ORACLE
from learning.figures.charts import headline, known
from learning.figures.style import title_of
from learning.reproduce import tables
from learning.reproduce.stages import EXPERIMENTS
from learning.reproduce.tables import Findings, Json, interval, markdown, percent
from learning.value_maps.report import ANOTHER, ONE_SIMULATION


@dataclass(frozen=True)
class PageSettings:
    """Write the results page of a reproduction from what its stages left.

    Example: vantage reproduce page --of reproduction/quick --preset quick
    """

    of: Path = Path("reproduction/quick")
    """Folder of the reproduction."""
    preset: str = "quick"
    """What the page calls its scale."""
    experiments: Path = EXPERIMENTS
    """Folder with JSON of levers that were tried."""


@dataclass(frozen=True)
class Target:
    """A row of what must be shown.

    Attributes:
        wanted: as the task says it.
        reached: what came out.
        met: None where there is nothing to judge.
    """

    wanted: str
    reached: str
    met: bool | None


def main(settings: PageSettings) -> int:
    """Write results.md; returns the exit code."""
    found = Findings(settings.of)
    missing = [name for name in ("accuracy", "maps") if not getattr(found, name)]
    if missing:
        print(f"{settings.of}/results holds no {' and no '.join(f'{name}.json' for name in missing)}: run the stages first")
        return 1
    path = settings.of / "results.md"
    partial = path.with_suffix(".partial")
    partial.write_text(page_of(found, settings.preset, settings.experiments))
    os.replace(partial, path)
    print(path)
    return 0


def page_of(found: Findings, preset: str, experiments: Path) -> str:
    """Return the page as Markdown."""
    sections = [
        _opening(found, preset),
        ["## Asked for, and reached", "", *target_table(found)],
        _table_one(found),
        _table_two(found),
        _play(found),
        _more_networks(found),
        _views(found),
        _levers(experiments),
        _data(found),
        _training(found),
        _commands(found),
    ]
    return "\n".join("\n".join([*section, ""]) for section in sections if section)


def _opening(found: Findings, preset: str) -> list[str]:
    machines = sorted({_machine(stamp["provenance"]) for stamp in found.stamps.values()})
    commits = sorted({_short(stamp["provenance"].get("commit", "")) for stamp in found.stamps.values()})
    total = sum(stamp["seconds"] for stamp in found.stamps.values())
    lines = [
        f"# The paper, reproduced: results of the preset `{preset}`",
        "",
        f"Written by `vantage reproduce --preset {preset}`, from the JSON in `results/`; no figure on this page was typed by "
        "hand. The paper: Chen, Hu, Kwiatkowski, Song, Lipson, *Visual Perspective Taking for Opponent Behavior Modeling*. Its "
        "code, data and simulator were never published, so its figures are of another simulation than ours: beside each other "
        "they say which order of methods holds and how far, not who is better.",
        "",
        f"Hardware: {'; '.join(machines)}. Commit: {', '.join(f'`{commit}`' for commit in commits)} (`+`: edited). "
        f"Time: {wall(found) / 60:.0f} minutes on the clock, {total / 60:.0f} minutes of stages, several at once.",
    ]
    taken = [name for name, stamp in found.stamps.items() if stamp.get("taken_from")]
    if taken:
        lines += ["", f"Taken over from earlier runs of the same commands on the same data: {', '.join(taken)}."]
    warnings = [line for report in (found.accuracy, *found.of_groups.values()) for line in report["warnings"]]
    return [*lines, *([""] if warnings else []), *(f"* Note: {line}" for line in dict.fromkeys(warnings))]


def wall(found: Findings) -> float:
    """Return the seconds in which at least one stage ran."""
    total = end = 0.0
    for stamp in sorted(found.stamps.values(), key=lambda stamp: stamp["began"]):
        last = stamp["began"] + stamp["seconds"]
        total += max(0.0, last - max(end, stamp["began"]))
        end = max(end, last)
    return total


def targets(found: Findings) -> list[Target]:
    """Return what the study had to show, beside what it showed; each judged by the network that saw most samples."""
    rows = []
    for name, least in (("vpt-tob", 0.8845), ("hazard", 0.92)):
        largest = found.largest(name, found.of_groups, found.accuracy)
        if largest is None:
            continue
        group, report = largest
        set_ = headline(report)
        one = set_["methods"][name]
        value, bounds = one["accuracy"], one["accuracy interval 95 %"]
        text = f"{percent(value)} % {interval(bounds)}, {_scale(found, group, name)}"
        title = f"{title_of(name)}, accuracy at T = {set_['horizon limit']}"
        rows.append(Target(f"{title}: at least {100 * least:g} %", text, value >= least))
        if name == "vpt-tob" and CLOCK in one["against"]:
            gain = one["against"][CLOCK]["difference"]
            above = f"{tables.over(one, CLOCK)} points ({CLOCK}: {percent(set_['methods'][CLOCK]['accuracy'])} %)"
            rows.append(Target(f"{title}: at least 10 points above the horizon-only predictor", above, gain >= 0.10))
    oracle = headline(found.accuracy)["methods"].get(ORACLE)
    if oracle:
        text = f"{percent(oracle['accuracy'])} % {interval(oracle['accuracy interval 95 %'])}"
        rows.append(Target("oracle (the ceiling): about 97 %", text, abs(oracle["accuracy"] - 0.97) <= 0.015))
    for name, least in (("vpt-tob", 0.88), ("hazard", 0.91)):
        largest = found.largest(name, found.maps_of_groups, found.maps)
        one = tables.best_tie_free(largest[1], name) if largest else None
        if largest and one and one["mean"] is not None:
            text = f"{percent(one['mean'])} % {interval(one['interval 95 %'])}, {_scale(found, largest[0], name)}"
            steps = largest[1]["horizons"][0]
            title = f"relative ranking accuracy, tie-free, T = {steps}, {title_of(name)}"
            rows.append(Target(f"{title}: at least {100 * least:g} %", text, one["mean"] >= least))
    ceiling = tables.best_tie_free(found.maps, ANOTHER)
    if ceiling and ceiling["mean"] is not None:
        text = f"{percent(ceiling['mean'])} % {interval(ceiling['interval 95 %'])}"
        rows.append(Target("the same of a second simulation: about 94 %", text, abs(ceiling["mean"] - 0.94) <= 0.02))
    rows += _loss(found)
    size = sum(path.stat().st_size for path in (found.folder / "weights" / found.compared).glob("*.safetensors"))
    rows.append(Target("weights of Table I: at most 10 MB in all", f"{size / 1e6:.1f} MB", size <= 10e6))
    return rows


def _loss(found: Findings) -> list[Target]:
    largest = found.largest("vpt-tob", found.maps_of_groups, found.maps)
    if largest is None or len(largest[1]["horizons"]) < 2:
        return []
    horizons = largest[1]["horizons"]
    rows = []
    for value, label in (("binary", "as in the paper"), ("expected", "by summed probabilities")):
        one = largest[1]["ranking"][str(horizons[-1])][ONE_SIMULATION].get(f"vpt-tob, {value}", {}).get("with_ties", {})
        change = one.get("change since the first horizon")
        if change and change["mean"] is not None:
            text = f"{100 * change['mean']:+.1f} points {interval(change['interval 95 %'], signed=True)}"
            what = f"change of the relative ranking accuracy from T = {horizons[0]} to {horizons[-1]}, {label}"
            rows.append(Target(f"{what}: a loss of at most 2.5 points", text, change["mean"] >= -0.025))
    return rows


def target_table(found: Findings) -> list[str]:
    """Return asked and reached, with a plain word on each."""
    rows = targets(found)
    words = {True: "met", False: "**not met**", None: ""}
    met = sum(row.met is True for row in rows)
    table = markdown(["asked for", "reached [95 %]", ""], [[row.wanted, row.reached, words[row.met]] for row in rows])
    return [f"{met} of {len(rows)} met. Each is judged by its value, not by the interval's end.", "", *table]


def _scale(found: Findings, group: str, name: str) -> str:
    card = found.cards.get(group or found.compared, {}).get(name, {})
    samples = card.get("training", {}).get("samples")
    return f"{samples:,} samples, preset `{card['preset']}`" if samples else "scale unknown"


def _table_one(found: Findings) -> list[str]:
    main = headline(found.accuracy)
    data = found.accuracy["data"]
    lines = [
        "## Table I: is the hider caught?",
        "",
        f"Seekers {', '.join(data['seekers'])}; layouts {', '.join(data['layouts'])}; {data['test episodes']} test games nobody "
        f"trained on; T = {main['horizon limit']}; t0 any step before the catch, horizon uniform; caught in "
        f"{percent(main['caught share'])} % of the examples. All methods answer the same examples. Intervals: games drawn again.",
        "",
        *_figure(found, "table-1.png"),
        *tables.table_one(found.accuracy),
        "",
        *tables.ordering(found.accuracy),
        "",
    ]
    for limit in sorted({each["horizon limit"] for each in found.accuracy["results"]} - {main["horizon limit"]}):
        set_ = tables.set_of(found.accuracy, "uniform", limit)
        if set_:
            rows = [
                [title_of(name), f"{percent(one['accuracy'])} {interval(one['accuracy interval 95 %'])}", tables.over(one, CLOCK)]
                for name, one in set_["methods"].items()
            ]
            lines += [f"At T = {limit}:", "", *markdown(["", "accuracy, % [95 %]", "over horizon only, points"], rows), ""]
    return [*lines, *_figure(found, "accuracy-over-horizon.png"), *_figure(found, "reliability.png"), *_from(found, "accuracy")]


def _table_two(found: Findings) -> list[str]:
    maps = found.maps
    lines = [
        "## Table II: value maps",
        "",
        f"{len(maps['starts'])} starts of test seeds, seeker `{maps['seeker']}`, layout `{maps['layout']}`. The truth: the hider "
        "is moved to every goal in simulation, with the seeds of the episode. Share of pairs of goals at least 3 cells apart "
        "whose order, equality included, agrees; mean ± standard deviation over maps. `binary` adds v as the paper does, "
        "`expected` adds probabilities; networks were trained on at most 200 steps.",
        "",
        *_figure(found, "table-2.png"),
        *tables.table_two(maps, "with_ties", with_paper=True),
        "",
        "Only pairs that differ in the truth:",
        "",
        *tables.table_two(maps, "without_ties", with_paper=False),
        "",
    ]
    seconds = ", ".join(f"{title_of(name)} {value:.2f} s" for name, value in maps["seconds per map"].items())
    lines += [f"A whole map takes: {seconds} (the paper: 1.4 s on one GPU).", "", *_figure(found, "value-maps.png")]
    for group, report in found.maps_of_groups.items():
        lines += [f"Networks of the group `{group}`, pairs that differ in the truth:", ""]
        lines += [*tables.table_two(report, "without_ties", with_paper=False), "", *_from(found, f"maps-of-{group}"), ""]
    return [*lines, *_from(found, "maps")]


def _play(found: Findings) -> list[str]:
    return [
        "## Play: a hider that follows the map",
        "",
        *_figure(found, "play.png"),
        *tables.played(found.maps),
        "",
        *_figure(found, "run.png"),
    ]


def _more_networks(found: Findings) -> list[str]:
    """Other scales, the paper's network, readings of the learning rate; and the compared networks on other data."""
    rows = []
    reports = {found.compared: found.accuracy, **found.of_groups}
    for group, report in reports.items():
        main = headline(report)
        for name in known(main["methods"]):
            one, card = main["methods"][name], found.cards.get(group, {}).get("vpt-tob" if name == "caught-head" else name, {})
            training = card.get("training", {})
            samples = training.get("samples")
            rows.append(
                [
                    group,
                    title_of(name),
                    card.get("preset", ""),
                    f"{samples:,}" if samples else "",
                    f"x{training['drop']:g}" if training.get("schedule") == "steps" else str(training.get("schedule", "")),
                    f"{percent(one['accuracy'])} {interval(one['accuracy interval 95 %'])}",
                    "" if one["AUROC"] is None else f"{one['AUROC']:.3f}",
                ]
            )
    head = ["group", "method", "preset", "samples", "learning rate", "accuracy, % [95 %]", "AUROC"]
    lines = ["## Scales, networks and readings of the learning rate", "", *markdown(head, rows), ""]
    methods = headline(found.accuracy)["methods"]
    true = [name for name in methods if name.startswith("true views") or name == "vpn-on-true"]
    if true:
        kinds = [[title_of(name), percent(methods[name]["accuracy"]), f"{methods[name]['AUROC'] or 0:.3f}"] for name in true]
        lines += ["Ablations of the VPN (on true views, or having learnt from them):", ""]
        lines += [*markdown(["", "accuracy, %", "AUROC"], kinds), ""]
    for kind, report in found.of_kinds.items():
        main = headline(report)
        rows = [
            [title_of(n), f"{percent(o['accuracy'])} {interval(o['accuracy interval 95 %'])}"] for n, o in main["methods"].items()
        ]
        lines += [f"The compared networks on `{kind}`, which they were not trained on:", ""]
        lines += [*markdown(["", "accuracy, % [95 %]"], rows), "", *_from(found, f"accuracy-{kind}"), ""]
    return [*lines, *[line for group in found.of_groups for line in _from(found, f"accuracy-of-{group}")]]


def _views(found: Findings) -> list[str]:
    names = ("training-pairs.png", "predicted-views.png", "side-by-side.png")
    drawn = [line for name in names for line in _figure(found, name)]
    return ["## What is predicted", "", *drawn] if drawn else []


def _levers(experiments: Path) -> list[str]:
    lines = []
    for path in sorted(experiments.glob("*.json")):
        found = tables.read(path)
        lines += [f"### {found.get('title', path.stem)}", "", *([str(found["why"]), ""] if found.get("why") else [])]
        rows: list[Json] = found.get("table", [])
        if rows:
            head = list(dict.fromkeys(column for row in rows for column in row))
            lines += [*markdown(head, [[_cell(row.get(column)) for column in head] for row in rows]), ""]
        lines += [str(found["found"]), ""] if found.get("found") else []
        command = found.get("provenance", {}).get("command")
        lines += [f"`{command}`, {_where(found['provenance'])}", ""] if command else []
    return ["## Levers that were tried", "", *lines] if lines else []


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def _data(found: Findings) -> list[str]:
    rows = []
    for folder in sorted((found.folder / "data").glob("*")):
        manifest = tables.read(folder / "manifest.json")
        dataset = tables.read(folder / "dataset/manifest.json")
        if not dataset:
            continue
        games = " / ".join(str(dataset["episodes"].get(split, 0)) for split in ("train", "validation", "test"))
        hiders = ", ".join(f"{name} {count}" for name, count in dataset["hiders"].items())
        size = sum(path.stat().st_size for path in (folder / "dataset").iterdir()) / 1e6
        rows.append(
            [folder.name, games, hiders, f"{size:.0f} MB", f"`{dataset['hash'][:16]}`", f"`{manifest.get('command', '')}`"]
        )
    head = ["kind", "games to train / validate / test", "hiders", "size", "hash", "made by"]
    return ["## Data", "", *markdown(head, rows)]


def _training(found: Findings) -> list[str]:
    rows = []
    for group, cards in found.cards.items():
        for stem, card in cards.items():
            training, stamp = card.get("training", {}), found.stamps.get(f"train-{group}-{stem}", {})
            seen = f"{training['samples']:,} samples" if training.get("samples") else f"{training.get('images', 0):,} views"
            minutes = f"{stamp['seconds'] / 60:.1f}" if stamp else ""
            where = f"{training.get('device', '')}, seed {training.get('seed', '')}"
            rows.append([f"{group}/{stem}", card.get("preset", ""), seen, minutes, where, f"`{card.get('sha256', '')[:12]}`"])
    head = ["weights", "preset", "seen", "minutes, start included", "on", "sha256"]
    return ["## Training", "", *markdown(head, rows)]


def _commands(found: Findings) -> list[str]:
    rows = [
        [name, f"`{stamp['command']}`", f"{stamp['seconds']:.0f}", f"`{_short(stamp['provenance'].get('commit', ''))}`"]
        for name, stamp in found.stamps.items()
        if name != "page"
    ]
    return ["## Every command", "", "Run in the repository's root.", "", *markdown(["stage", "command", "s", "commit"], rows)]


def _figure(found: Findings, name: str) -> list[str]:
    captions = tables.read(found.folder / "figures/figures.json").get("figures", {})
    return [f"![{captions[name]}](figures/{name})", "", f"*{captions[name]}*", ""] if name in captions else []


def _from(found: Findings, result: str) -> list[str]:
    """Return where a result comes from: command, seed, commit, hardware."""
    report = tables.read(found.folder / f"results/{result}.json")
    stamp = found.stamps.get(f"evaluate-{result}")
    command = stamp["command"] if stamp else report["provenance"]["command"]
    return [f"From `{command}` (seed {report['seed']}), {_where(report['provenance'])}."]


def _where(provenance: Json) -> str:
    return f"commit `{_short(provenance.get('commit', ''))}`, {_machine(provenance)}"


def _machine(provenance: Json) -> str:
    hardware = provenance.get("hardware")
    if not hardware:
        return "unknown hardware"
    return ", ".join([f"{hardware['cores']} cores of {hardware['cpu']}", *hardware["gpus"]])


def _short(commit: str) -> str:
    return (commit[:10] + ("+" if commit.endswith("+") else "")) if commit else "unknown"
