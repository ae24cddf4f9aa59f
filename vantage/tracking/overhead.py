"""Follows the tags on robots and boxes through the overhead camera's pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from schemas import Box
from vantage.tracking.calibration import Calibration
from vantage.tracking.filter import TrackState
from vantage.tracking.table import Table

Picture = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class OverheadSettings:
    """How tags are followed."""

    forget_after: float = 0.5
    """s without its tag until a robot's track ends"""
    search_period: float = 2.0
    """s between two searches of the whole picture"""


@dataclass(frozen=True, slots=True)
class Observation:
    """What one picture says.

    Attributes:
        tracks: by robot; None where nothing is known.
        boxes: obstacles found so far, held steady; in the order of the table.
        troubles: for people, one line each.
        full_search: whether the whole picture was searched.
    """

    tracks: dict[str, TrackState | None]
    boxes: tuple[Box, ...]
    troubles: tuple[str, ...]
    full_search: bool


class OverheadTracker:
    """Follows the tags from picture to picture. Not thread-safe."""

    def __init__(self, table: Table, calibration: Calibration, settings: OverheadSettings | None = None) -> None:
        self.table, self.calibration, self.settings = table, calibration, settings or OverheadSettings()

    def observe(self, picture: Picture, stamp: int) -> Observation:
        """Take the next picture: uint8 [H, W] or [H, W, 3] RGB, captured at stamp (ns). Never raises for what is in a picture."""
        raise NotImplementedError
