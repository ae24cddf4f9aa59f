"""One rendered table for all tests of the overhead camera."""

from __future__ import annotations

import datetime
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from schemas import Box
from vantage.rehearsal.overhead_light import OverheadLook
from vantage.rehearsal.overhead_picture import OverheadScene, rehearsal_camera
from vantage.tracking.calibration import Calibration, Lens
from vantage.tracking.overhead import Observation, OverheadSettings, OverheadTracker
from vantage.tracking.table import default_table
from vantage.world.layout import LAB

Floats = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

TODAY = datetime.date(2026, 5, 1)
FRAME = 33_333_333
START = 1_700_000_000_000_000_000
ROBOTS = np.array([[0.25, 0.30, 0.7], [0.95, 0.45, -2.0]])


@lru_cache(maxsize=1)
def scene() -> OverheadScene:
    return OverheadScene(default_table(), rehearsal_camera(), OverheadLook())


def calibration() -> Calibration:
    return rehearsal_camera()


def lens() -> Lens:
    truth = rehearsal_camera()
    return Lens(width=truth.width, height=truth.height, matrix=truth.matrix, distortion=truth.distortion, residual=0.0)


def picture(robots: Floats = ROBOTS, boxes: tuple[Box, ...] = LAB, frame: int = 0, speeds: Floats | None = None) -> Picture:
    return scene().render(robots, boxes, 7, frame, speeds)


def window_of(corners: Floats, margin: int) -> tuple[slice, slice]:
    """Rows and columns around a tag's corners."""
    low, high = corners.min(axis=0).astype(int) - margin, corners.max(axis=0).astype(int) + margin + 1
    return slice(max(low[1], 0), high[1]), slice(max(low[0], 0), high[0])


def covered(seen: Picture, *tags: int, robots: Floats = ROBOTS, boxes: tuple[Box, ...] = LAB) -> Picture:
    """A picture with some tags papered over."""
    changed = seen.copy()
    corners = scene().true_corners(robots, boxes)
    for tag in tags:
        changed[window_of(corners[tag], 8)] = 120
    return changed


def copied(seen: Picture, tag: int, column: int, row: int, robots: Floats = ROBOTS, boxes: tuple[Box, ...] = LAB) -> Picture:
    """A picture with a second tag of an id, pasted with its left upper corner at a place."""
    changed = seen.copy()
    patch = seen[window_of(scene().true_corners(robots, boxes)[tag], 12)]
    changed[row : row + patch.shape[0], column : column + patch.shape[1]] = patch
    return changed


class Watch:
    """A tracker that is shown frames at 30 a second."""

    def __init__(self, settings: OverheadSettings | None = None) -> None:
        self.tracker = OverheadTracker(default_table(), calibration(), settings)
        self.stamp = START

    def show(self, seen: Picture, times: int = 1) -> Observation:
        for _ in range(times):
            observation = self.tracker.observe(seen, self.stamp)
            self.stamp += FRAME
        return observation
