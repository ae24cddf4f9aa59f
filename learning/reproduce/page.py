"""`vantage reproduce page`: the results page of a reproduction, written from the JSON that its stages left.

Every sentence with a number in it is made from results. Levers that were tried are read from docs/experiments/*.json:

    {"title": "...", "why": "...", "table": [{"column": "value", ...}, ...], "found": "...", "provenance": {...}}
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from learning.accuracy.report import CLOCK
from learning.figures.charts import headline, known
from learning.figures.style import title_of
from learning.reproduce import tables
from learning.reproduce.ceiling import what_can_be_known
from learning.reproduce.stages import EXPERIMENTS
from learning.reproduce.tables import Findings, Json, interval, markdown, percent
from learning.reproduce.targets import target_table, wall


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
        ["## Asked for, and reached", "", *target_table(found, preset)],
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
    given = [f"{group}/{stem}" for group, cards in found.cards.items() for stem in cards if not _stamp(found, group, stem)]
    if given:
        lines += ["", f"Given from outside, and told of by their cards alone: {', '.join(given)}."]
    warnings = [line for report in (found.accuracy, *found.of_groups.values()) for line in report["warnings"]]
    return [*lines, *([""] if warnings else []), *(f"* Note: {line}" for line in dict.fromkeys(warnings))]


def _table_one(found: Findings) -> list[str]:
    main = headline(found.accuracy)
    data = found.accuracy["data"]
    lines = [
        "## Table I: is the hider caught?",
        "",
        f"Seekers {', '.join(data['seekers'])}; layouts {', '.join(data['layouts'])}; {data['test episodes']} test games nobody "
        f"trained on; T = {main['horizon limit']}; t0 any step before the catch, horizon uniform; caught in "
        f"{percent(main['caught share'])} % of the examples. All methods but the oracle answer all of the examples. "
        "Intervals: games drawn again.",
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
    lines += what_can_be_known(found)
    return [*lines, *_figure(found, "accuracy-over-horizon.png"), *_figure(found, "reliability.png"), *_from(found, "accuracy")]


def _table_two(found: Findings) -> list[str]:
    maps = found.maps
    lines = [
        "## Table II: value maps",
        "",
        f"{len(maps['starts'])} starts of test seeds, seeker `{maps['seeker']}`, layout `{maps['layout']}`. The truth: the hider "
        "is moved to every goal in simulation, with the seeds of the episode. Share of pairs of goals at least 3 cells apart "
        "whose order, equality included, agrees; mean ± standard deviation over maps. `binary` adds v as the paper does, "
        "`expected` adds probabilities, which never tie, so that every pair that ties in the truth counts against it where "
        "equality is included; `rounded` rounds that sum to whole checkpoints. Networks were trained on at most 200 steps.",
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
            training, stamp = card.get("training", {}), _stamp(found, group, stem)
            seen = f"{training['samples']:,} samples" if training.get("samples") else f"{training.get('images', 0):,} views"
            minutes = f"{stamp['seconds'] / 60:.1f}" if stamp else f"{training.get('minutes', 0):.1f} (card)"
            games = card.get("data", {}).get("episodes", {}).get("train", "")
            where = f"{training.get('device', '')}, seed {training.get('seed', '')}"
            rows.append(
                [f"{group}/{stem}", card.get("preset", ""), seen, str(games), minutes, where, f"`{card.get('sha256', '')[:12]}`"]
            )
    head = ["weights", "preset", "seen", "games to train", "minutes, start included", "on", "sha256"]
    return ["## Training", "", *markdown(head, rows)]


def _stamp(found: Findings, group: str, stem: str) -> Json:
    """Return the stamp of the stage that trained some weights; empty where they were given."""
    return found.stamps.get(f"train-{group}-{stem}", {})


def _commands(found: Findings) -> list[str]:
    rows = [
        [name, f"`{stamp['command']}`", f"{stamp['seconds']:.0f}", f"`{_short(stamp['provenance'].get('commit', ''))}`"]
        for name, stamp in sorted(found.stamps.items(), key=lambda item: item[1]["began"])
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
