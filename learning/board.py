"""Curves and pictures of a training for TensorBoard: `tensorboard --logdir runs` shows every training below a folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


class Board:
    """Writes into a workspace; a resumed training takes its curves up where it goes on.

    Args:
        workspace: folder of the training.
        seen: samples seen so far; what an earlier run wrote beyond them is hidden.
    """

    def __init__(self, workspace: Path, seen: int = 0) -> None:
        from torch.utils.tensorboard import SummaryWriter  # takes a second

        self._writer = SummaryWriter(str(workspace), purge_step=seen or None)

    def curves(self, values: Mapping[str, float], seen: int) -> None:
        """Add a point to each curve. Names such as `validation/loss` are grouped by what is before the slash."""
        for name, value in values.items():
            self._writer.add_scalar(name.replace(" ", "-"), value, seen)
        self._writer.flush()

    def picture(self, name: str, picture: NDArray[np.uint8], seen: int) -> None:
        """Add a picture, uint8 [height, width, 3]."""
        self._writer.add_image(name, picture, seen, dataformats="HWC")
        self._writer.flush()

    def close(self) -> None:
        """The last call."""
        self._writer.close()
