"""From the two pictures of an RGB-D camera to the depth and colour image of the contract.

The contract (`schemas.DepthImage`, `vantage.world.camera`): a pinhole over the robot's centre that looks horizontally along
its heading, depth along that axis, colour registered. A real camera is tilted, sits off the centre, has two lenses and more
pixels: `RgbdPreparer` registers depth to the colour lens, turns the points into the level frame and gathers them into the
published pixels. What it cannot see stays 0.

Level frame: origin over the robot's centre at the depth lens's height, x right of the heading, y down, z along the heading.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import numpy.typing as npt

from schemas import Intrinsics
from vantage.tracking.colors import ColorCorrection
from vantage.tracking.rgbd_lens import Lens, lens_of
from vantage.world.arena import MOUNT_HEIGHT

Bytes = npt.NDArray[np.uint8]
Depths = npt.NDArray[np.uint16]

PUBLISHED_WIDTH = 160
PUBLISHED_HEIGHT = 120
PUBLISHED_FOV = math.radians(86.0)

Turn = tuple[float, float, float, float, float, float, float, float, float]
Shift = tuple[float, float, float]


class UnusableRgbdCalibration(Exception):
    """A calibration that cannot be used; the text says what is wrong and what to do."""

    for_people = True


class RgbdCalibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An RGB-D camera and how it sits on its robot; file `{robot}.json`."""

    depth: Lens
    color: Lens
    rotation: Turn = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    """depth lens -> colour lens, row-major: p_color = rotation @ p_depth + translation"""
    translation: Shift = (0.0, 0.0, 0.0)
    """m"""
    mount_height: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = MOUNT_HEIGHT
    """depth lens above the floor, m"""
    tilt: Annotated[float, msgspec.Meta(ge=-0.8, le=0.8)] = 0.0
    """by which the camera looks down, rad"""
    forward: Annotated[float, msgspec.Meta(ge=-0.2, le=0.2)] = 0.0
    """depth lens ahead of the robot's centre, m"""
    left: Annotated[float, msgspec.Meta(ge=-0.2, le=0.2)] = 0.0
    """depth lens to the left of the robot's centre, m"""
    depth_unit: Annotated[float, msgspec.Meta(gt=0.0, le=0.1)] = 0.001
    """m a count of the depth picture"""
    nearest: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.04
    """depths below this are not believed, m"""
    correction: ColorCorrection = msgspec.field(default_factory=ColorCorrection)
    date: str = ""
    """ISO date of the calibration"""
    made_with: str = ""


def default_rgbd() -> RgbdCalibration:
    """The camera of the rehearsal: 640 x 480, depth 87 and colour 90 degrees wide, 15 mm apart, looking 5 degrees down."""
    return RgbdCalibration(
        depth=lens_of(640, 480, math.radians(87.0)),
        color=lens_of(640, 480, math.radians(90.0)),
        translation=(-0.015, 0.0, 0.0),
        tilt=math.radians(5.0),
    )


def load_rgbd(path: Path) -> RgbdCalibration:
    """Read and check a calibration. Raises UnusableRgbdCalibration."""
    raise NotImplementedError


def save_rgbd(calibration: RgbdCalibration, path: Path) -> None:
    """Write a calibration as JSON."""
    path.write_bytes(msgspec.json.format(msgspec.json.encode(calibration), indent=2) + b"\n")


def published_intrinsics(calibration: RgbdCalibration, width: int, height: int) -> Intrinsics:
    """The level pinhole of the published pictures."""
    focal = width / (2.0 * math.tan(PUBLISHED_FOV / 2.0))
    return Intrinsics(fx=focal, fy=focal, cx=(width - 1) / 2.0, cy=(height - 1) / 2.0, mount_height=calibration.mount_height)


class RgbdPreparer:
    """`prepare` for one camera: tables and buffers are made once."""

    def __init__(self, calibration: RgbdCalibration, width: int = PUBLISHED_WIDTH, height: int = PUBLISHED_HEIGHT) -> None:
        self.intrinsics = published_intrinsics(calibration, width, height)

    def prepare(self, depth: Depths, color: Bytes) -> tuple[Depths, Bytes, Intrinsics]:
        """depth uint16 [H, W] counts, color uint8 [H, W, 3] RGB -> depth uint16 [h, w] mm, color uint8 [h, w, 3], intrinsics.

        The arrays returned are the preparer's own and overwritten by the next call. Raises ValueError where the pictures do
        not fit the calibration.
        """
        raise NotImplementedError


def prepare(
    depth: Depths, color: Bytes, calibration: RgbdCalibration, width: int = PUBLISHED_WIDTH, height: int = PUBLISHED_HEIGHT
) -> tuple[Depths, Bytes, Intrinsics]:
    """As `RgbdPreparer.prepare`, into fresh arrays; for callers with one picture."""
    return RgbdPreparer(calibration, width, height).prepare(depth, color)
