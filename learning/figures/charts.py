"""Charts of results: Table I as bars, accuracy over horizon, reliability, Table II over horizon, survival in play."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from learning.accuracy.report import CLOCK, MAJORITY, ORACLE
from learning.figures.style import METHODS, OTHER, QUIET, color_of, new_figure, title_of
from learning.methods.table import METHODS as METHOD_TABLE
from learning.value_maps.page import PAPER as PAPER_RANKING
from learning.value_maps.play import BEST, UNIFORM
from learning.value_maps.report import ANOTHER, ONE_SIMULATION

Result = dict[str, Any]
DASHES = {MAJORITY: ":", CLOCK: "--", ORACLE: "-."}


def headline(accuracy: Result) -> Result:
    """Return the set of examples that stands for the paper's: any step as t0, the longest T, the most examples."""
    return max(accuracy["results"], key=lambda found: (found["start"] == "uniform", found["horizon limit"], found["examples"]))


def known(found: Iterable[str]) -> list[str]:
    """Return the methods among some names, in the order of the legend."""
    names = set(found)
    return [name for name in METHODS if name in names]


def table_one(accuracy: Result) -> Figure:
    """Draw the accuracy of every method as bars, with the paper's figures."""
    result = headline(accuracy)
    methods = result["methods"]
    order = sorted(known(methods), key=lambda name: methods[name]["accuracy"])
    shown = [name for name in (MAJORITY, CLOCK) if name in methods] + order + [name for name in (ORACLE,) if name in methods]
    caption = (
        f"{result['examples']:,} unseen examples of {result['episodes']} test games, t0 any step before the catch, horizon below "
        f"{result['horizon limit']}.\nBlack line: 95 % interval (games drawn again). Diamond: the paper's figure, for another "
        "simulation. Grey: no network."
    )
    figure = new_figure(0.42 * len(shown) + 2.2, "Is the hider caught? Accuracy (Table I)", caption, width=12)
    height = figure.get_figheight()
    axes = figure.add_axes((0.23, 1.15 / height, 0.74, 1 - 1.85 / height))
    for row, name in enumerate(shown):
        value = 100 * methods[name]["accuracy"]
        low, high = (100 * bound for bound in methods[name]["accuracy interval 95 %"])
        axes.barh(row, value, color=color_of(name), height=0.66)
        axes.plot([low, high], [row, row], color="black", linewidth=2)
        axes.text(40.7, row, f"{value:.1f} %", va="center", fontsize=11, color="white", fontweight="bold", zorder=6)
        paper = METHOD_TABLE[name].paper if name in METHOD_TABLE else None
        if paper is not None:
            axes.plot(100 * paper, row, "D", color="white", markeredgecolor="black", markersize=9, zorder=5)
    axes.set_yticks(range(len(shown)), [title_of(name) for name in shown], fontsize=11)
    axes.set_xlim(40, 100)
    axes.set_xlabel("right answers, %  (the axis begins at 40 %)", fontsize=11)
    _quiet(axes)
    return figure


def over_horizon(accuracy: Result) -> Figure:
    """Draw the accuracy of every method in each bin of horizons, for t0 any step and for t0 = 0."""
    longest = headline(accuracy)["horizon limit"]
    sets = [found for found in accuracy["results"] if found["horizon limit"] == longest]
    by_start = {found["start"]: found for found in sorted(sets, key=lambda found: found["examples"])}
    titles = {"uniform": "asked at any step before the catch", "first": "asked at step 0, as the planner asks"}
    figure = new_figure(5.6, "Accuracy over horizon", "Each point: examples whose horizon lies in a bin of 20 steps.")
    for index, (start, result) in enumerate(by_start.items()):
        axes = figure.add_axes((0.055 + index * 0.40, 0.16, 0.365, 0.68))
        for name in [*(name for name in (MAJORITY, CLOCK, ORACLE) if name in result["methods"]), *known(result["methods"])]:
            bins = result["methods"][name]["by horizon"]
            middles = [sum(map(int, text.split(".."))) / 2 for text in bins]
            values = [100 * found["accuracy"] for found in bins.values()]
            axes.plot(middles, values, DASHES.get(name, "-"), color=color_of(name), linewidth=2, marker="o", markersize=4)
        axes.set_title(titles[start], fontsize=12)
        axes.set_xlabel("horizon, steps ahead", fontsize=11)
        axes.set_ylabel("right answers, %" if index == 0 else "", fontsize=11)
        _quiet(axes)
    _legend(figure, [MAJORITY, CLOCK, ORACLE, *known(headline(accuracy)["methods"])], set(headline(accuracy)["methods"]))
    return figure


def reliability(accuracy: Result) -> Figure:
    """Draw for every method how often those were caught to whom it gave a risk."""
    result = headline(accuracy)
    shown = known(result["methods"])
    columns = min(4, len(shown))
    rows = -(-len(shown) // columns)
    caption = (
        "Each point: a tenth of the examples. On the diagonal, risks can be taken at their word. ECE: mean distance from the "
        f"diagonal. {result['examples']:,} examples, horizon below {result['horizon limit']}."
    )
    figure = new_figure(3.5 * rows + 1.3, "Can the risks be taken at their word? Reliability", caption, width=3.4 * columns + 0.6)
    height = figure.get_figheight()
    grid = figure.add_gridspec(
        rows, columns, left=0.55 / figure.get_figwidth(), right=0.985, top=1 - 0.95 / height, bottom=1.05 / height, hspace=0.38
    )
    for index, name in enumerate(shown):
        axes = figure.add_subplot(grid[index // columns, index % columns])
        found = result["methods"][name]["calibration"]
        axes.plot([0, 100], [0, 100], color="0.7", linewidth=1, linestyle="--")
        told = [100 * part["probability"] for part in found["bins"]]
        true = [100 * part["caught share"] for part in found["bins"]]
        axes.plot(told, true, "o-", color=color_of(name), linewidth=2)
        axes.set_title(f"{title_of(name)}\nECE {100 * found['expected calibration error']:.1f} points", fontsize=11)
        axes.set_xlim(-3, 103)
        axes.set_ylim(-3, 103)
        axes.set_aspect("equal")
        if index // columns == rows - 1 or index + columns >= len(shown):
            axes.set_xlabel("risk told, %", fontsize=11)
        if index % columns == 0:
            axes.set_ylabel("truly caught, %", fontsize=11)
        _quiet(axes)
    return figure


def table_two(maps: Result) -> Figure:
    """Draw the relative ranking accuracy over T: as in the paper, and without the ties of the truth."""
    horizons = maps["horizons"]
    caption = (
        "Value maps, mean over starts. Dotted: another simulation of the same starts. Networks are trained on at most 200 steps."
    )
    figure = new_figure(5.6, "Which of two goals is more dangerous? Relative ranking accuracy (Table II)", caption)
    measures = (
        ("with_ties", "binary", "binary v, equality included, as in the paper"),
        ("without_ties", "expected", "summed probabilities, pairs that differ in the truth"),
    )
    names = [name for name in METHODS if f"{name}, expected" in maps["ranking"][str(horizons[0])][ONE_SIMULATION]]
    for index, (measure, value, title) in enumerate(measures):
        axes = figure.add_axes((0.055 + index * 0.40, 0.16, 0.365, 0.68))
        for name in [ANOTHER, *names]:
            key = name if name == ANOTHER else f"{name}, {value}"
            found = [maps["ranking"][str(steps)][ONE_SIMULATION][key][measure]["mean"] for steps in horizons]
            values = [float("nan") if value is None else 100 * value for value in found]
            style = ":" if name == ANOTHER else "-"
            axes.plot(horizons, values, style, color=color_of(name), linewidth=2, marker="o", markersize=4)
        paper = [steps for steps in horizons if steps in PAPER_RANKING]
        if measure == "with_ties" and paper:
            axes.plot(paper, [PAPER_RANKING[steps][0] for steps in paper], "D--", color="black", markerfacecolor="white")
        axes.set_title(title, fontsize=12)
        axes.set_xticks(horizons)
        axes.set_xlabel("T, steps", fontsize=11)
        axes.set_ylabel("pairs in the true order, %" if index == 0 else "", fontsize=11)
        _quiet(axes)
    handles = [Line2D([], [], color=color_of(name), linewidth=2, label=title_of(name)) for name in names]
    handles.append(Line2D([], [], color=OTHER, linestyle=":", linewidth=2, label=ANOTHER))
    handles.append(Line2D([], [], color="black", linestyle="--", marker="D", markerfacecolor="white", label="the paper"))
    figure.legend(handles=handles, loc="center left", bbox_to_anchor=(0.845, 0.5), fontsize=10, frameon=False)
    return figure


def play_chart(maps: Result) -> Figure:
    """Draw how long a hider stays free that drives to the goal each method chooses."""
    steps = str(maps["horizons"][0])
    found = maps["play"][steps]
    labels = {name: title_of(name.removesuffix(", expected")) for name in found if not name.endswith(", binary")}
    labels[BEST] = "the best goal"
    order = sorted(labels, key=lambda name: found[name]["survival"]["mean"])
    caption = (
        f"{len(maps['starts'])} starts, {maps['simulations']} simulations of each goal. Black line: 95 % interval of the mean."
    )
    figure = new_figure(0.4 * len(order) + 1.9, f"How long is a hider free that follows the map? T = {steps}", caption, width=12)
    height = figure.get_figheight()
    axes = figure.add_axes((0.36, 1.0 / height, 0.61, 1 - 1.65 / height))
    for row, name in enumerate(order):
        survival = found[name]["survival"]
        color = "black" if name in (BEST, UNIFORM) else color_of(name.removesuffix(", expected"))
        axes.barh(row, survival["mean"], color=color, height=0.66, alpha=0.9)
        low, high = survival["interval 95 %"]
        axes.plot([low, high], [row, row], color="black" if color != "black" else "0.6", linewidth=2)
        axes.text(2, row, f"{survival['mean']:.0f}", va="center", fontsize=11, color="white", fontweight="bold")
    axes.set_yticks(range(len(order)), [labels[name] for name in order], fontsize=11)
    axes.set_xlim(0, int(steps))
    axes.set_xlabel("steps until caught (T where never), mean over starts", fontsize=11)
    _quiet(axes)
    return figure


def _legend(figure: Figure, order: list[str], present: set[str]) -> None:
    handles = [
        Line2D([], [], color=color_of(name), linestyle=DASHES.get(name, "-"), linewidth=2, label=title_of(name))
        for name in order
        if name in present
    ]
    figure.legend(handles=handles, loc="center left", bbox_to_anchor=(0.845, 0.5), fontsize=10, frameon=False)


def _quiet(axes: Axes) -> None:
    axes.grid(color="0.9", axis="both")
    axes.set_axisbelow(True)
    axes.tick_params(colors=QUIET)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
