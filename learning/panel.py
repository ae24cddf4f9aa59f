"""A picture of predictions: input, action maps, predicted and true seeker view, a row a sample."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot
from numpy.typing import NDArray

from learning.dataset import Batch

_TITLES = ("I_H at t0", "F", "T", "predicted I_S", "true I_S")


def draw_panel(path: Path, batch: Batch, views: NDArray[np.uint8], rows: int = 6) -> None:
    """Write a PNG of the first samples of a batch. `views` uint8 [B, 128, 128, 3]: predicted seeker views."""
    rows = min(rows, len(views))
    figure, axes = pyplot.subplots(rows, 5, figsize=(10, 2.1 * rows), squeeze=False)
    for row, line in enumerate(axes):
        inputs = batch.inputs[row]
        frequency, time = (np.where(inputs[..., k + 1] > 0, inputs[..., k], 255) for k in (3, 5))
        for axis, picture in zip(line, (inputs[..., :3], frequency, time, views[row], batch.targets[row]), strict=True):
            axis.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
            axis.set_xticks([])
            axis.set_yticks([])
        line[0].set_ylabel(f"t0 {batch.samples.start[row]}, +{batch.samples.horizon[row]}")
        line[4].set_xlabel("caught" if batch.caught[row] else "free")
    for axis, title in zip(axes[0], _TITLES, strict=True):
        axis.set_title(title, fontsize=9)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=70)
    pyplot.close(figure)
