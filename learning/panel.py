"""A picture of predictions: input, action maps, predicted and true view, a row a sample."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from learning.dataset import Batch, Target
from vantage.output import complete
from vantage.perception.palette import view_for_people


def draw_panel(path: Path, batch: Batch, views: NDArray[np.uint8], target: Target = "seeker", rows: int = 6) -> NDArray[np.uint8]:
    """Write a PNG of the first samples of a batch, and return it, uint8 [height, width, 3].

    Args:
        views: the predicted ones, uint8 [B, 128, 128, 3].
        target: whose views they are.
    """
    rows = min(rows, len(views))
    figure = Figure(figsize=(10, 2.1 * rows), dpi=70)
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots(rows, 5, squeeze=False)
    for row, line in enumerate(axes):
        inputs = batch.inputs[row]
        frequency, time = (np.where(inputs[..., k + 1] > 0, inputs[..., k], 255) for k in (3, 5))
        seen = view_for_people(inputs[..., :3], "hider")
        predicted, true = (view_for_people(view, target) for view in (views[row], batch.targets[row]))
        for axis, picture in zip(line, (seen, frequency, time, predicted, true), strict=True):
            axis.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
            axis.set_xticks([])
            axis.set_yticks([])
        line[0].set_ylabel(f"t0 {batch.samples.start[row]}, +{batch.samples.horizon[row]}")
        line[4].set_xlabel("caught" if batch.caught[row] else "free")
    whose = "I_S" if target == "seeker" else "I_H"
    for axis, title in zip(axes[0], ("I_H at t0", "F", "T", f"predicted {whose}", f"true {whose}"), strict=True):
        axis.set_title(title, fontsize=9)
    figure.tight_layout()
    with complete(path) as partial:
        figure.savefig(partial)
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
