"""What the study had to show, beside what it showed."""

from __future__ import annotations

from dataclasses import dataclass

from learning.accuracy.report import CLOCK, ORACLE, VIEW_ORACLE
from learning.figures.charts import headline
from learning.figures.style import title_of
from learning.reproduce import tables
from learning.reproduce.presets import RELEASED
from learning.reproduce.tables import Findings, interval, markdown, percent
from learning.value_maps.report import ANOTHER, ONE_SIMULATION, VIEW_ORACLE_MAP


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


def wall(found: Findings) -> float:
    """Return the seconds in which at least one stage ran."""
    total = end = 0.0
    for stamp in sorted(found.stamps.values(), key=lambda stamp: stamp["began"]):
        last = stamp["began"] + stamp["seconds"]
        total += max(0.0, last - max(end, stamp["began"]))
        end = max(end, last)
    return total


def targets(found: Findings, preset: str) -> list[Target]:
    """Return what the study had to show, beside what it showed; each judged by the network that saw most samples."""
    rows = []
    for name, least in (("vpt-tob", 0.8845), ("hazard", 0.92), ("hazard-attention", 0.92)):
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
    for name, least in (("vpt-tob", 0.88), ("hazard", 0.91), ("hazard-attention", 0.91)):
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
    rows += _knowable(found)
    rows += _loss(found)
    rows += _size(found)
    return rows + _time(found) if preset == "quick" else rows


def _knowable(found: Findings) -> list[Target]:
    """What can be known from the hider's view: not asked for, and the measure of what was."""
    rows = []
    asked = tables.set_of(found.accuracy, "first", headline(found.accuracy)["horizon limit"])
    if asked and VIEW_ORACLE in asked["methods"]:
        one, clock = asked["methods"][VIEW_ORACLE], asked["methods"][CLOCK]["accuracy"]
        text = f"{percent(one['accuracy'])} % {interval(one['accuracy interval 95 %'])} ({CLOCK}: {percent(clock)} %)"
        rows.append(Target("beside it, what can be known from the hider's view (`view oracle`, t0 = 0), accuracy", text, None))
    one = tables.best_tie_free(found.maps, VIEW_ORACLE_MAP) if found.maps else None
    if one and one["mean"] is not None:
        text = f"{percent(one['mean'])} % {interval(one['interval 95 %'])}, mean of {found.maps['simulations']} simulations"
        rows.append(Target("the same, relative ranking accuracy, tie-free", text, None))
    return rows


def _size(found: Findings) -> list[Target]:
    files = sorted((found.folder / "weights" / RELEASED.name).glob("*.safetensors"))
    size = sum(path.stat().st_size for path in files)
    return [Target("released weights: at most 10 MB in all", f"{size / 1e6:.1f} MB", size <= 10e6)] if files else []


def _time(found: Findings) -> list[Target]:
    cores = {stamp["provenance"]["hardware"]["cores"] for stamp in found.stamps.values()}
    clock = wall(found) / 60
    whole = not any(stamp["taken_from"] or stamp.get("resumed") for stamp in found.stamps.values())
    here = cores == {2} and whole
    text = f"{clock:.0f} minutes on {' or '.join(map(str, sorted(cores)))} cores{'' if whole else ', not all in one go'}"
    return [Target("`quick`: 30 minutes on 2 cores", text, clock <= 30 if here else None)]


def _loss(found: Findings) -> list[Target]:
    largest = found.largest("vpt-tob", found.maps_of_groups, found.maps)
    if largest is None or len(largest[1]["horizons"]) < 2:
        return []
    horizons = largest[1]["horizons"]
    rows = []
    for value, measure, label in (
        ("binary", "with_ties", "binary v, equality included, as in the paper"),
        ("expected", "without_ties", "summed probabilities, tie-free"),
    ):
        one = largest[1]["ranking"][str(horizons[-1])][ONE_SIMULATION].get(f"vpt-tob, {value}", {}).get(measure, {})
        change = one.get("change since the first horizon")
        if change and change["mean"] is not None:
            text = f"{100 * change['mean']:+.1f} points {interval(change['interval 95 %'], signed=True)}"
            what = f"change of the relative ranking accuracy from T = {horizons[0]} to {horizons[-1]}, {label}"
            rows.append(Target(f"{what}: a loss of at most 2.5 points", text, change["mean"] >= -0.025))
    return rows


def target_table(found: Findings, preset: str) -> list[str]:
    """Return asked and reached, with a plain word on each."""
    rows = targets(found, preset)
    words = {True: "met", False: "**not met**", None: ""}
    met, judged = sum(row.met is True for row in rows), sum(row.met is not None for row in rows)
    table = markdown(["asked for", "reached [95 %]", ""], [[row.wanted, row.reached, words[row.met]] for row in rows])
    return [f"{met} of {judged} met. Each is judged by its value, not by the interval's end.", "", *table]


def _scale(found: Findings, group: str, name: str) -> str:
    group = group or found.compared
    card = found.cards.get(group, {}).get(name, {})
    samples, games = card.get("training", {}).get("samples"), card.get("data", {}).get("episodes", {}).get("train")
    where = f"group `{group}`"
    return f"{where}: {samples:,} samples of {games:,} games, preset `{card['preset']}`" if samples and games else where
