"""What the study had to show, beside what it showed."""

from __future__ import annotations

from dataclasses import dataclass

from learning.accuracy.report import CLOCK, ORACLE, VIEW_ORACLE
from learning.figures.charts import headline
from learning.figures.style import title_of
from learning.reproduce import tables
from learning.reproduce.tables import Findings, accuracy_of, interval, markdown, percent
from learning.value_maps.report import ANOTHER, ONE_SIMULATION, VIEW_ORACLE_MAP


@dataclass(frozen=True)
class Target:
    """A row of what must be shown.

    Attributes:
        wanted: as the task says it.
        reached: what came out.
        met: None where there is nothing to judge.
        networks: which networks it came out of, with what is to be said of them; empty where it is of none.
    """

    wanted: str
    reached: str
    met: bool | None
    networks: str = ""


def targets(found: Findings, preset: str) -> list[Target]:
    """Return what the study had to show, beside what it showed, of the networks of Table I and of those that saw most samples."""
    rows = []
    for name, least in (("vpt-tob", 0.8845), ("hazard", 0.92), ("hazard-attention", 0.92)):
        for group, report in found.judged_for(name, found.of_groups, found.accuracy):
            set_, networks = headline(report), found.networks(group, name)
            one = set_["methods"][name]
            title = f"{title_of(name)}, accuracy at T = {set_['horizon limit']}"
            rows.append(Target(f"{title}: at least {100 * least:g} %", accuracy_of(one), one["accuracy"] >= least, networks))
            if name == "vpt-tob" and CLOCK in one["against"]:
                gain = one["against"][CLOCK]["difference"]
                above = f"{tables.over(one, CLOCK)} points ({CLOCK}: {percent(set_['methods'][CLOCK]['accuracy'])})"
                rows.append(Target(f"{title}: at least 10 points above {CLOCK}", above, gain >= 0.10, networks))
    oracle = headline(found.accuracy)["methods"].get(ORACLE)
    if oracle:
        rows.append(Target("oracle (the ceiling): about 97 %", accuracy_of(oracle), abs(oracle["accuracy"] - 0.97) <= 0.015))
    for name, least in (("vpt-tob", 0.88), ("hazard", 0.91), ("hazard-attention", 0.91)):
        for group, report in found.judged_for(name, found.maps_of_groups, found.maps):
            best = tables.best_tie_free(report, name)
            if best and best["mean"] is not None:
                title = f"relative ranking accuracy, tie-free, T = {report['horizons'][0]}, {title_of(name)}"
                wanted = f"{title}: at least {100 * least:g} %"
                rows.append(Target(wanted, _mean(best), best["mean"] >= least, found.networks(group, name)))
    ceiling = tables.best_tie_free(found.maps, ANOTHER)
    if ceiling and ceiling["mean"] is not None:
        rows.append(Target("the same of a second simulation: about 94 %", _mean(ceiling), abs(ceiling["mean"] - 0.94) <= 0.02))
    rows += _knowable(found)
    rows += _loss(found)
    rows += _size(found)
    return rows + _time(found) if preset == "quick" else rows


def _mean(found: tables.Json) -> str:
    return f"{percent(found['mean'])} {interval(found['interval 95 %'])}"


def _knowable(found: Findings) -> list[Target]:
    """Return what can be known from the hider's view: not asked for, and the measure of what was."""
    rows = []
    asked = tables.set_of(found.accuracy, "first", headline(found.accuracy)["horizon limit"])
    if asked and VIEW_ORACLE in asked["methods"]:
        one, clock = asked["methods"][VIEW_ORACLE], asked["methods"][CLOCK]["accuracy"]
        text = f"{accuracy_of(one)} ({CLOCK}: {percent(clock)})"
        rows.append(Target("beside it, what can be known from the hider's view (`view oracle`, t0 = 0), accuracy", text, None))
    best = tables.best_tie_free(found.maps, VIEW_ORACLE_MAP) if found.maps else None
    if best and best["mean"] is not None:
        text = f"{_mean(best)}, mean of {found.maps['simulations']} simulations"
        rows.append(Target("the same, relative ranking accuracy, tie-free", text, None))
    return rows


def _size(found: Findings) -> list[Target]:
    size = found.made.get("released bytes", 0)
    return [Target("released weights: at most 10 MB in all", f"{size / 1e6:.1f} MB", size <= 10e6)] if size else []


def _time(found: Findings) -> list[Target]:
    cores = {stage["hardware"]["cores"] for stage in found.stages.values()}
    clock = found.made["minutes on the clock"]
    whole = not any(stage["taken_from"] or stage["resumed"] for stage in found.stages.values())
    here = cores == {2} and whole
    text = f"{clock:.0f} minutes on {' or '.join(map(str, sorted(cores)))} cores{'' if whole else ', not all in one go'}"
    return [Target("`quick`: 30 minutes on 2 cores", text, clock <= 30 if here else None)]


def _loss(found: Findings) -> list[Target]:
    rows = []
    for group, report in found.judged_for("vpt-tob", found.maps_of_groups, found.maps):
        horizons = report["horizons"]
        for value, measure, label in (
            ("binary", "with_ties", "binary v, equality included, as in the paper"),
            ("expected", "without_ties", "summed probabilities, tie-free"),
        ):
            one = report["ranking"][str(horizons[-1])][ONE_SIMULATION].get(f"vpt-tob, {value}", {}).get(measure, {})
            change = one.get("change since the first horizon") if len(horizons) > 1 else None
            if change and change["mean"] is not None:
                text = f"{100 * change['mean']:+.1f} points {interval(change['interval 95 %'], signed=True)}"
                what = f"change of the relative ranking accuracy from T = {horizons[0]} to {horizons[-1]}, {label}"
                wanted = f"{what}: a loss of at most 2.5 points"
                rows.append(Target(wanted, text, change["mean"] >= -0.025, found.networks(group, "vpt-tob")))
    return rows


def target_table(found: Findings, preset: str) -> list[str]:
    """Return asked and reached, with a plain word on each and the networks it is of."""
    rows = targets(found, preset)
    words = {True: "met", False: "**not met**", None: ""}
    met, judged = sum(row.met is True for row in rows), sum(row.met is not None for row in rows)
    table = markdown(
        ["asked for", "reached, % [95 %]", "", "of which networks"],
        [[row.wanted, row.reached, words[row.met], row.networks] for row in rows],
    )
    return [f"{met} of {judged} met. Each is judged by its value, not by the interval's end.", "", *table]
