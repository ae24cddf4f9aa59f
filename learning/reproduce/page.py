"""`vantage reproduce page`: the results pages of a reproduction, written from the JSON that its stages left in `results/`.

Every sentence with a number in it is made from results. Levers that were tried are read from docs/experiments/*.json:

    {"title": "...", "why": "...", "table": [{"column": "value", ...}, ...], "found": "...", "provenance": {...}}
"""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from learning.figures.charts import headline, known
from learning.figures.style import title_of
from learning.reproduce import tables
from learning.reproduce.ceiling import what_can_be_known
from learning.reproduce.made import Json, read, seed_of
from learning.reproduce.stages import EXPERIMENTS
from learning.reproduce.tables import Findings, accuracy_of, markdown, percent
from learning.reproduce.targets import target_table
from vantage.errors import UserError
from vantage.output import write_complete

LEVERS = "results-levers.md"
PAGES = ("results.md", LEVERS)
"""What is written, in the reproduction's folder."""


@dataclass(frozen=True)
class PageSettings:
    """Write the results page of a reproduction from what its stages left.

    Examples:
      vantage reproduce page --of reproduction/quick --preset quick
      vantage reproduce page --of docs --preset hours
    """

    of: Path = Path("reproduction/quick")
    """Folder of the reproduction; or `docs`, to write the published page again from the published results."""
    preset: str = "quick"
    """What the page calls its scale."""
    experiments: Path = EXPERIMENTS
    """Folder with JSON of levers that were tried."""


def main(settings: PageSettings) -> int:
    """Write the pages; returns the exit code."""
    found = Findings(settings.of, settings.preset)
    missing = [name for name in ("accuracy", "maps") if not getattr(found, name)]
    if missing:
        names = " and no ".join(f"{name}.json" for name in missing)
        raise UserError(f"{settings.of}/results holds no {names}: run the stages first")
    write_complete(settings.of / "results/made.json", json.dumps(found.made, indent=2) + "\n")
    write_complete(settings.of / "results.md", page_of(found, settings.preset, settings.experiments))
    write_complete(settings.of / LEVERS, levers_page(settings.experiments))
    print(settings.of / "results.md")
    return 0


def page_of(found: Findings, preset: str, experiments: Path) -> str:
    """Return the page as Markdown."""
    sections = [
        _opening(found, preset),
        ["## Asked for, and reached", "", *target_table(found, preset)],
        _table_one(found),
        _table_two(found),
        _play(found),
        _views(found),
        _levers(experiments),
        _seeds(found),
        _data(found),
        _training(found),
    ]
    return "\n".join("\n".join([*section, ""]) for section in sections if section)


def _opening(found: Findings, preset: str) -> list[str]:
    machines = sorted({_machine(stage["hardware"]) for stage in found.stages.values()})
    commits = sorted({_short(stage["commit"]) for stage in found.stages.values()})
    total = sum(stage["seconds"] for stage in found.stages.values())
    lines = [
        f"# The paper, reproduced: results of the preset `{preset}`",
        "",
        f"Written by `vantage reproduce --preset {preset}`, from the JSON in `results/`; no figure on this page was typed by "
        "hand. The paper: Chen, Hu, Kwiatkowski, Song, Lipson, *Visual Perspective Taking for Opponent Behavior Modeling*. Its "
        "code, data and simulator were never published, so its figures are of another simulation than ours: beside each other "
        "they say which order of methods holds and how far, not who is better.",
        "",
        "How to read it: each figure is of a *group* of networks, named beside it, and figures of different groups are not to be "
        "compared as if only the method differed. " + _groups(found),
        "",
        f"Hardware: {'; '.join(machines)}. Commit: {', '.join(f'`{commit}`' for commit in commits)} (`+`: edited). "
        f"Time: {found.made['minutes on the clock']:.0f} minutes on the clock, {total / 60:.0f} minutes of stages, several at "
        "once. Every command: [results/made.json](results/made.json).",
    ]
    if note := found.made.get("note"):
        lines += ["", note]
    taken = [name for name, stage in found.stages.items() if stage["taken_from"]]
    if taken:
        lines += ["", f"Taken over from earlier runs of the same commands on the same data: {', '.join(taken)}."]
    warnings = [line for report in (found.accuracy, *found.of_groups.values()) for line in report["warnings"]]
    return [*lines, *([""] if warnings else []), *(f"* Note: {line}" for line in dict.fromkeys(warnings))]


def _groups(found: Findings) -> str:
    """Return what each group is, and how often its networks were trained."""
    texts = []
    for group, cards in found.cards.items():
        what = "Table I: equal data, equal samples" if group == found.compared else "trained by the stages"
        if not any(_stage(found, group, stem) for stem in cards):
            what = "given from outside, known by their cards alone"
        trained = Counter(stem.partition("-seed")[0] for stem in cards)
        often = max(trained.values(), default=1)
        texts.append(f"`{group}`: {what}, {'one training seed' if often == 1 else f'{often} training seeds'} each")
    once = all("-seed" not in stem for cards in found.cards.values() for stem in cards)
    spread = " No network was trained twice, so how far another seed would lie is not known." if once else ""
    return "; ".join(texts) + "." + spread + " Intervals are over games, not over trainings."


def _table_one(found: Findings) -> list[str]:
    main = headline(found.accuracy)
    data = found.accuracy["data"]
    lines = [
        "## Table I: is the hider caught?",
        "",
        f"Networks: `{found.compared}`. Seekers {', '.join(data['seekers'])}; layouts {', '.join(data['layouts'])}; "
        f"{data['test episodes']} test games not trained on; T = {main['horizon limit']}; t0 any step before the catch, horizon "
        f"uniform; caught in {percent(main['caught share'])} % of the examples. Intervals: games drawn again. By T, horizon and "
        "hider: [results/accuracy.md](results/accuracy.md).",
        "",
        *_figure(found, "table-1.png"),
        *tables.table_one(found.accuracy),
        "",
        *tables.ordering(found.accuracy),
        "",
        *_more_networks(found),
        *what_can_be_known(found),
        *tables.daggers(found, found.of_groups),
    ]
    return [*lines, *_figure(found, "accuracy-over-horizon.png"), *_figure(found, "reliability.png")]


def _more_networks(found: Findings) -> list[str]:
    """Return other scales, networks and readings of the learning rate on the same examples; and other data."""
    rows = []
    for group, report in found.of_groups.items():
        main = headline(report)
        for name in known(main["methods"]):
            one, card = main["methods"][name], found.card(group, name)
            training = card.get("training", {})
            steps = f", x{training['drop']:g}" if training.get("schedule") == "steps" else ""
            spread = f"; seeds {tables.over_seeds(one['over seeds'])}" if "over seeds" in one else ""
            area = "" if one["AUROC"] is None else f"{one['AUROC']:.3f}"
            networks = found.networks(group, name)
            rows.append([title_of(name), f"{accuracy_of(one)}{spread}", area, f"{card.get('preset', '')}{steps}", networks])
    lines = []
    if rows:
        head = ["", "accuracy, % [95 % over games]", "AUROC", "preset", "of which networks"]
        lines += ["Other networks, asked as Table I's (any step as t0, the longest T):", "", *markdown(head, rows), ""]
    methods = headline(found.accuracy)["methods"]
    true = [name for name in methods if name.startswith("true views") or name == "vpn-on-true"]
    if true:
        kinds = [[title_of(name), percent(methods[name]["accuracy"]), f"{methods[name]['AUROC'] or 0:.3f}"] for name in true]
        lines += [f"Ablations of the VPN, `{found.compared}` (on true views, or having learnt from them):", ""]
        lines += [*markdown(["", "accuracy, %", "AUROC"], kinds), ""]
    for kind, report in found.of_kinds.items():
        texts = [f"{title_of(name)} {accuracy_of(one)}" for name, one in headline(report)["methods"].items()]
        page = f"[results/accuracy-{kind}.md](results/accuracy-{kind}.md)"
        lines += [f"`{found.compared}` on `{kind}`, which they were not trained on, %: {'; '.join(texts)} ({page}).", ""]
    return lines


def _table_two(found: Findings) -> list[str]:
    maps = found.maps
    seconds = ", ".join(f"{title_of(name)} {value:.2f} s" for name, value in maps["seconds per map"].items())
    pages = ["maps", *(f"maps-of-{group}" for group in found.maps_of_groups)]
    return [
        "## Table II: value maps",
        "",
        f"{len(maps['starts'])} starts of test seeds, seeker `{maps['seeker']}`, layout `{maps['layout']}`. The truth: the hider "
        "is moved to every goal in simulation, with the seeds of the episode. Share of pairs of goals at least 3 cells apart "
        "whose order agrees; mean ± standard deviation over maps. Networks were trained on at most 200 steps. All measures and "
        f"ways to add up: {', '.join(f'[results/{page}.md](results/{page}.md)' for page in pages)}.",
        "",
        *_figure(found, "table-2.png"),
        "As in the paper: v is 0 or 1, equality included:",
        "",
        *tables.table_two(found, "binary", "with_ties", with_paper=True),
        "",
        "Summed probabilities, over pairs that differ in the truth (probabilities never tie):",
        "",
        *tables.table_two(found, "expected", "without_ties", with_paper=False),
        "",
        *tables.daggers(found, found.maps_of_groups),
        f"A whole map takes: {seconds} (the paper: 1.4 s on one GPU).",
        "",
        *_figure(found, "value-maps.png"),
    ]


def _play(found: Findings) -> list[str]:
    return [
        "## Play: a hider that follows the map",
        "",
        *_figure(found, "play.png"),
        *tables.played(found),
        "",
        *tables.daggers(found, found.maps_of_groups),
        *_figure(found, "run.png"),
    ]


def _views(found: Findings) -> list[str]:
    names = ("training-pairs.png", "predicted-views.png", "side-by-side.png")
    drawn = [line for name in names for line in _figure(found, name)]
    networks = read(found.folder / "figures/figures.json").get("networks", found.compared)
    return ["## What is predicted", "", f"Networks: `{networks}`.", "", *drawn] if drawn else []


def _levers(experiments: Path) -> list[str]:
    lines = []
    for path in sorted(experiments.glob("*.json")):
        lever = read(path)
        lines.append(f"* **{lever.get('title', path.stem)}.** {lever.get('found', '')}")
    head = ["## Levers that were tried", "", f"Tables and commands: [{LEVERS}]({LEVERS}).", ""]
    return [*head, *lines] if lines else []


def levers_page(experiments: Path) -> str:
    """Return the page with the tables of all levers that were tried."""
    lines = [
        "# Levers that were tried",
        "",
        "Written by `vantage reproduce`; what came of them is in [results.md](results.md).",
        "",
    ]
    for path in sorted(experiments.glob("*.json")):
        found = read(path)
        lines += [f"## {found.get('title', path.stem)}", "", *([str(found["why"]), ""] if found.get("why") else [])]
        rows: list[Json] = found.get("table", [])
        if rows:
            head = list(dict.fromkeys(column for row in rows for column in row))
            lines += [*markdown(head, [[_cell(row.get(column)) for column in head] for row in rows]), ""]
        lines += [str(found["found"]), ""] if found.get("found") else []
        provenance = found.get("provenance", {})
        if command := provenance.get("command"):
            hardware = _machine(provenance.get("hardware", {}))
            lines += [f"`{command}`, commit `{_short(provenance.get('commit', ''))}`, {hardware}", ""]
    return "\n".join(lines)


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def _seeds(found: Findings) -> list[str]:
    """Return whose seed each network is of, and how that is known."""
    weights = [(group, stem, card) for group, cards in found.cards.items() for stem, card in cards.items()]
    lines = ["## Is every network of the seed that its card names?", ""]
    old = {f"{group}/{stem}" for group, stem, card in weights if not card.get("identity")}
    if old:
        lines += [
            "A checkpoint's identity once left out the seed: a training with a second seed in the same workspace went on with "
            "the network of the first, under a card that named the second. Cards now hold a hash of all that decides a training, "
            "its seed included; cards without one are from before.",
            "",
        ]
    by_command, by_card = list[str](), list[str]()
    for group, stem, card in weights:
        name, stage, seed = f"{group}/{stem}", _stage(found, group, stem), seed_of(card)
        if not stage:
            by_card.append(name)
        elif (asked := _seed_in(stage["command"])) == seed:
            by_command.append(name)
        else:
            lines.append(f"* **{name}**: its command asks for seed {asked}, its card says {seed}.")
    if by_command:
        lines.append(
            f"* Shown by their commands: {', '.join(by_command)}. Each was trained by a command of `results/made.json`, in a "
            "workspace of its own, with the seed that its card names (without `--seeds`: 1)."
        )
    if by_card:
        witness = "the identity in their cards holds the seed"
        if old & set(by_card):
            witness = "their cards are the only witness, as the commands that trained them are not on record"
            if {seed_of(card) for _, _, card in weights} == {"1"}:
                witness += "; it takes two seeds to mix them up, and no card or command on record names another than 1"
        lines.append(f"* Given, not trained here: {', '.join(by_card)}: {witness}.")
    if not any(line.startswith("* **") for line in lines):
        lines.append("* No figure on this page is known to be of another seed than its card says.")
    return lines


def _seed_in(command: str) -> str:
    words = command.split()
    for option in ("--seeds", "--seed"):
        if option in words[:-1]:
            return words[words.index(option) + 1]
    return "1"


def _data(found: Findings) -> list[str]:
    rows = []
    for kind, data in found.made["data"].items():
        games = " / ".join(str(data["episodes"].get(split, 0)) for split in ("train", "validation", "test"))
        hiders = ", ".join(f"{name} {count}" for name, count in data["hiders"].items())
        rows.append([kind, games, hiders, f"{data['megabytes']} MB", f"`{data['hash'][:16]}`"])
    return ["## Data", "", *markdown(["kind", "games to train / validate / test", "hiders", "size", "hash"], rows)]


def _training(found: Findings) -> list[str]:
    rows = []
    for group, cards in found.cards.items():
        for stem, card in cards.items():
            training, stage = card.get("training", {}), _stage(found, group, stem)
            seen = f"{training['samples']:,} samples" if training.get("samples") else f"{training.get('images', 0):,} views"
            taken = training.get("minutes")
            minutes = f"{stage['seconds'] / 60:.1f}" if stage else f"{taken:.1f} (card)" if taken else ""
            games = card.get("data", {}).get("episodes", {}).get("train", "")
            where = f"{training.get('device', '')}, seed {seed_of(card)}"
            rows.append(
                [f"{group}/{stem}", card.get("preset", ""), seen, str(games), minutes, where, f"`{card.get('sha256', '')[:12]}`"]
            )
    head = ["weights", "preset", "seen", "games to train", "minutes, start included", "on", "sha256"]
    return ["## Training", "", *markdown(head, rows)]


def _stage(found: Findings, group: str, stem: str) -> Json:
    """Return the stage that trained some weights; empty where they were given."""
    return found.stages.get(f"train-{group}-{stem}", {})


def _figure(found: Findings, name: str) -> list[str]:
    captions = read(found.folder / "figures/figures.json").get("figures", {})
    return [f"![{captions[name]}](figures/{name})", f"*{captions[name]}*", ""] if name in captions else []


def _machine(hardware: Json) -> str:
    if not hardware:
        return "unknown hardware"
    return ", ".join([f"{hardware['cores']} cores of {hardware['cpu']}", *hardware.get("gpus", [])])


def _short(commit: str) -> str:
    return (commit[:10] + ("+" if commit.endswith("+") else "")) if commit else "unknown"
