"""The calibration of the overhead camera: lens and place over the arena. File `overhead.json`."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Meta

from vantage.tracking.errors import CalibrationFailed, UnusableCalibration
from vantage.tracking.lens import BoardDescription, Lens, LensResult, calibrate_lens
from vantage.tracking.table import Table

__all__ = ["BoardDescription", "Calibration", "Lens", "LensResult", "calibrate_arena", "calibrate_lens", "load_calibration"]

Picture = npt.NDArray[np.uint8]

OLDEST_DAYS = 90
GREATEST_ARENA_RESIDUAL = 3.0
"""mm, root mean square of the corner tags' corners on the floor."""


class Calibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Lens and place of the overhead camera."""

    width: Annotated[int, Meta(ge=16, le=16384, description="of the pictures, px")]
    height: Annotated[int, Meta(ge=16, le=16384, description="of the pictures, px")]
    matrix: Annotated[tuple[float, ...], Meta(min_length=9, max_length=9, description="3 x 3 by rows, px")]
    distortion: Annotated[tuple[float, ...], Meta(min_length=5, max_length=5, description="k1, k2, p1, p2, k3")]
    rotation: Annotated[tuple[float, ...], Meta(min_length=9, max_length=9, description="3 x 3 by rows, arena -> camera")]
    translation: Annotated[tuple[float, ...], Meta(min_length=3, max_length=3, description="arena -> camera, m")]
    lens_residual: Annotated[float, Meta(ge=0.0, description="px, root mean square")]
    arena_residual: Annotated[float, Meta(ge=0.0, description="mm on the floor, root mean square")]
    date: Annotated[datetime.date, Meta(description="of the arena calibration")]
    made_with: str = ""


def load_calibration(path: Path, width: int, height: int, today: datetime.date, oldest_days: int = OLDEST_DAYS) -> Calibration:
    """Read a calibration and refuse one that must not be used.

    Raises:
        UnusableCalibration: missing, malformed, of another resolution, older than so many days, residuals above the limits.
    """
    raise UnusableCalibration("not yet")


def save_calibration(calibration: Calibration, path: Path) -> None:
    """Write a calibration, replacing the file at once.

    Raises:
        UnusableCalibration: cannot be written.
    """


def calibrate_arena(picture: Picture, table: Table, lens: Lens, date: datetime.date, made_with: str = "") -> Calibration:
    """Find the camera's place over the arena from one picture of the corner tags.

    Args:
        picture: uint8 [H, W] or [H, W, 3] RGB, of the lens's resolution.

    Raises:
        CalibrationFailed: wrong resolution, corner tags not seen or seen twice, or they do not lie where the table says.
    """
    raise CalibrationFailed("not yet")
