"""Value maps beside the ground truth, and a run that follows one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from learning.figures.style import DANGER_MAP, arena, color_of, new_figure, robot, title_of
from learning.value_maps.ranking import agreement
from vantage.world.arena import GOALS
from vantage.world.layout import make_layout
from vantage.world.motion import heading_radians

Arrays = dict[str, NDArray[Any]]
CHECKPOINTS_EVERY = 10
WANTED = ("vpt-tob", "hazard", "hazard-attention", "self-perspective", "vector-action", "coordinate-path")
"""Methods whose maps are shown, as far as they are there."""


def read_maps(path: Path) -> Arrays:
    """Return what `vantage evaluate maps` left for figures (see `learning.value_maps.report.arrays`)."""
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def value_maps(found: Arrays, layout: str, rows: int = 4, horizon: int = 0) -> Figure:
    """Draw true and predicted value maps of the first few starts, at one horizon (row of `horizons`) (paper, Fig. 6)."""
    rows = min(rows, len(found["seeds"]))
    predictors = list(found["predictors"])
    methods = [name for name in WANTED if f"{name}, expected" in predictors]
    steps = int(found["horizons"][horizon])
    count = steps // CHECKPOINTS_EVERY
    caption = (
        f"Danger: at how many of {count} checkpoints (one every {CHECKPOINTS_EVERY} steps) the hider is expected to be caught, "
        "for each of 121 goals. Star: the goal chosen; green and red disc: hider and seeker at the start.\n"
        "First column: the mean of simulations; below each map: pairs of goals in the true order, ties in the truth left out."
    )
    columns = 1 + len(methods)
    side = min((14.4 - 1.2) / columns, 3.0)
    height = rows * (side + 0.32) + 1.75
    figure = new_figure(
        height, f"Value maps of the first {rows} starts, T = {steps} steps", caption, width=max(columns * side + 1.3, 10.0)
    )
    grid = figure.add_gridspec(
        rows,
        columns,
        left=0.02,
        right=1 - 1.0 / figure.get_figwidth(),
        top=1 - 0.85 / height,
        bottom=0.95 / height,
        wspace=0.06,
        hspace=0.32 / side,
    )
    norm = Normalize(0, count)
    for row in range(rows):
        boxes = make_layout(layout, int(found["seeds"][row]))
        truth = found["truth_mean"][row, horizon].astype(np.float64)
        for column in range(columns):
            axes = figure.add_subplot(grid[row, column])
            arena(axes, boxes, ticks=False)
            if column == 0:
                values, goal, below = truth, int(np.nanargmin(truth)), "simulated"
            else:
                index = predictors.index(f"{methods[column - 1]}, expected")
                values, goal = found["values"][index, row, horizon].astype(np.float64), int(found["chosen"][index, row, horizon])
                below = f"{agreement(values, truth).without_ties:.0%} of pairs in order"
            _map(axes, values, norm)
            for index, who in enumerate(("hider", "seeker")):
                x, y, number = found["poses"][row, index]
                robot(axes, who, x, y, float(heading_radians(int(number))))  # type: ignore[arg-type]
            axes.plot(*GOALS[goal], "*", color="gold", markeredgecolor="black", markersize=15, zorder=8)
            axes.set_xlabel(below, fontsize=10)
            if row == 0:
                name = "true" if column == 0 else title_of(methods[column - 1])
                axes.set_title(name, fontsize=12, color="black" if column == 0 else color_of(methods[column - 1]))
    place = figure.add_axes((1 - 0.85 / figure.get_figwidth(), 0.95 / height, 0.18 / figure.get_figwidth(), 1 - 1.85 / height))
    bar = figure.colorbar(ScalarMappable(norm, DANGER_MAP), cax=place)
    bar.set_label(f"danger: caught at so many of {count} checkpoints", fontsize=11)
    return figure


def _map(axes: Axes, danger: NDArray[np.float64], norm: Normalize) -> None:
    image = np.ma.masked_invalid(danger.reshape(11, 11))
    axes.imshow(image, origin="lower", extent=(0.05, 1.15, 0.05, 1.15), cmap=DANGER_MAP, norm=norm, zorder=1)
    blocked = GOALS[np.isnan(danger)]
    axes.plot(blocked[:, 0], blocked[:, 1], "x", color="0.6", markersize=4, zorder=2)
