"""From the two pictures of an RGB-D camera to the depth and colour image of the contract.

The contract (`schemas.DepthImage`, `vantage.world.camera`): a pinhole over the robot's centre that looks horizontally along
its heading, depth along that axis, colour registered. A real camera is tilted, sits off the centre, has two lenses and more
pixels: `RgbdPreparer` turns every depth pixel into a point, looks up its colour where the colour lens sees it (what is nearer
hides it), and gathers the points, as seen from the level frame, into the published pixels. What the depth lens cannot see stays
0; what only the colour lens cannot see is black, which the filter takes for no robot.

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
from vantage.errors import UserError
from vantage.output import write_complete
from vantage.tracking.colors import ColorCorrection
from vantage.tracking.rgbd_kernels import BLOCK, find_places, gather, sort_into_cells
from vantage.tracking.rgbd_lens import Lens, lens_of, pixel_rays, project
from vantage.tracking.table import MAXIMUM_FILE_SIZE
from vantage.world.arena import MOUNT_HEIGHT

Bytes = npt.NDArray[np.uint8]
Depths = npt.NDArray[np.uint16]

PUBLISHED_WIDTH = 160
PUBLISHED_HEIGHT = 120
PUBLISHED_FOV = math.radians(86.0)

_FINEST = 0.75
"""Published pixels per depth pixel, at most: beyond, slanted surfaces would leave published pixels without a sample."""
_FEWEST_SHARE = 0.125
"""Share of a published pixel's nominal samples below which it is a hole: single samples at an edge are flying pixels."""
_DENSE = 8.0
"""Samples a published pixel from which on every second one's colour is enough."""

Turn = tuple[float, float, float, float, float, float, float, float, float]
Shift = tuple[float, float, float]


class UnusableRgbdCalibration(UserError):
    """A calibration that cannot be used; the text says what is wrong and what to do."""


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
    try:
        if path.stat().st_size > MAXIMUM_FILE_SIZE:
            raise UnusableRgbdCalibration(f"{path} is not a camera's calibration: it has more than {MAXIMUM_FILE_SIZE} bytes")
        calibration = msgspec.json.decode(path.read_bytes(), type=RgbdCalibration)
    except OSError as error:
        raise UnusableRgbdCalibration(f"{path}: {error.strerror}; calibrate the camera (`vantage table calibrate`)") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UnusableRgbdCalibration(f"{path}: {error}; correct it or calibrate the camera again") from None
    try:
        check_rgbd(calibration)
    except UnusableRgbdCalibration as error:
        raise UnusableRgbdCalibration(f"{path}: {error}") from None
    return calibration


def check_rgbd(calibration: RgbdCalibration) -> None:
    """Raise UnusableRgbdCalibration where no such camera can be."""
    numbers = (*calibration.rotation, *calibration.translation, *calibration.depth.distortion, *calibration.color.distortion)
    if not all(map(math.isfinite, numbers)):
        raise UnusableRgbdCalibration("holds a number that is not finite; calibrate the camera again")
    rotation = np.array(calibration.rotation).reshape(3, 3)
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) or np.linalg.det(rotation) < 0.0:
        raise UnusableRgbdCalibration("depth-to-colour rotation is no rotation; calibrate the camera again")
    if rotation[2, 2] < math.cos(math.radians(30.0)):
        raise UnusableRgbdCalibration("depth and colour lens look more than 30 degrees apart; calibrate the camera again")
    apart = math.hypot(*calibration.translation)
    if apart > 0.15:
        raise UnusableRgbdCalibration(f"depth and colour lens are {apart:.3f} m apart, more than any camera; is a unit wrong?")
    for name, lens in (("depth", calibration.depth), ("colour", calibration.color)):
        try:
            pixel_rays(lens)
        except ValueError as error:
            raise UnusableRgbdCalibration(f"{name} lens: {error}") from None


def save_rgbd(calibration: RgbdCalibration, path: Path) -> None:
    """Write a calibration as JSON, replacing the file at once."""
    write_complete(path, msgspec.json.format(msgspec.json.encode(calibration), indent=2) + b"\n")


def published_intrinsics(calibration: RgbdCalibration, width: int, height: int) -> Intrinsics:
    """The level pinhole of the published pictures."""
    focal = width / (2.0 * math.tan(PUBLISHED_FOV / 2.0))
    return Intrinsics(fx=focal, fy=focal, cx=(width - 1) / 2.0, cy=(height - 1) / 2.0, mount_height=calibration.mount_height)


def coverage(calibration: RgbdCalibration, distance: float = 0.6) -> tuple[float, float]:
    """Shares (0..1) of the published columns in which the depth lens, and both lenses, see a wall across, `distance` m ahead.

    Counted at the height of the depth lens down to half of it. Below 1 the other robot is missed at the picture's sides: the
    lens is too narrow, tilted or too far ahead of the robot's centre.
    """
    pinhole = published_intrinsics(calibration, PUBLISHED_WIDTH, PUBLISHED_HEIGHT)
    across = distance * (np.arange(PUBLISHED_WIDTH) - pinhole.cx) / pinhole.fx
    below = np.linspace(0.0, 0.5 * calibration.mount_height, 5)
    right, down = np.meshgrid(across, below)
    place = np.array([-calibration.left, 0.0, calibration.forward])
    points = (np.stack((right, down, np.full_like(right, distance)), axis=-1) - place) @ level_rotation(calibration.tilt)
    rotation = np.array(calibration.rotation, dtype=np.float64).reshape(3, 3)
    shares = []
    visible = np.ones(right.shape, dtype=bool)
    for lens, seen in ((calibration.depth, points), (calibration.color, points @ rotation.T + np.array(calibration.translation))):
        pixels = project(lens, seen)
        inside = (pixels > -0.5) & (pixels < np.array([lens.width - 0.5, lens.height - 0.5]))
        visible &= np.all(inside, axis=-1) & (seen[..., 2] > 0.0)
        shares.append(float(np.mean(np.any(visible, axis=0))))
    return shares[0], shares[1]


class RgbdPreparer:
    """`prepare` for one camera: tables and buffers are made once."""

    def __init__(self, calibration: RgbdCalibration, width: int = PUBLISHED_WIDTH, height: int = PUBLISHED_HEIGHT) -> None:
        """Raises UnusableRgbdCalibration, also where the published picture has more pixels across than the camera resolves."""
        check_rgbd(calibration)
        self.calibration = calibration
        self.intrinsics = published_intrinsics(calibration, width, height)
        depth_lens, color_lens = calibration.depth, calibration.color
        if self.intrinsics.fx > _FINEST * min(depth_lens.fx, depth_lens.fy):
            raise UnusableRgbdCalibration(
                f"{width} published columns are finer than the camera's {depth_lens.width} x {depth_lens.height} depth pixels; "
                "publish fewer columns or let the camera give more"
            )
        rotation = np.array(calibration.rotation, dtype=np.float64).reshape(3, 3)
        density = (depth_lens.fx * depth_lens.fy) / (self.intrinsics.fx * self.intrinsics.fy)
        self._fewest = max(1, int(_FEWEST_SHARE * density))
        self._color_every = 2 if density >= _DENSE else 1
        self._slopes = np.ascontiguousarray(np.moveaxis(pixel_rays(depth_lens), -1, 1).astype(np.float32))
        place = np.array([-calibration.left, 0.0, calibration.forward])
        self._to_level = np.column_stack((level_rotation(calibration.tilt), place)).astype(np.float32)
        self._to_color = np.column_stack((rotation, np.array(calibration.translation))).astype(np.float32)
        self._pinhole = np.array([self.intrinsics.fx, self.intrinsics.fy, self.intrinsics.cx, self.intrinsics.cy])
        self._color_lens = np.array([color_lens.fx, color_lens.fy, color_lens.cx, color_lens.cy])
        self._distortion = np.array(color_lens.distortion, dtype=np.float64)
        self._largest_square = 1.2 * float(np.max(np.sum(np.square(pixel_rays(color_lens)), axis=-1)))
        self._matrix = np.array(calibration.correction.matrix, dtype=np.float64).reshape(3, 3)
        self._offset = np.array(calibration.correction.offset, dtype=np.float64)

        size, cells = (depth_lens.height, depth_lens.width), width * height
        self._cells = np.empty(size, np.int32)
        self._depths = np.empty(size, np.float32)
        self._places = np.empty(size, np.int32)
        self._color_depths = np.empty(size, np.float32)
        self._nearest = np.empty((-(-color_lens.height // BLOCK), -(-color_lens.width // BLOCK)), np.float32)
        self._starts = np.empty(cells + 1, np.int32)
        self._ends = np.empty(cells, np.int32)
        self._sample_depths = np.empty(depth_lens.width * depth_lens.height, np.float32)
        self._sample_places = np.empty(depth_lens.width * depth_lens.height, np.int32)
        self._ordered = np.empty(256, np.float32)
        self.shape = (height, width)
        """Rows and columns of the published pictures."""
        self._depth_out = np.zeros((height, width), np.uint16)
        self._color_out = np.zeros((height, width, 3), np.uint8)

    def require(self, depth: Depths, color: Bytes) -> None:
        """Raise ValueError where the pictures do not fit the calibration."""
        depth_lens, color_lens = self.calibration.depth, self.calibration.color
        require_picture("depth", depth, np.uint16, (depth_lens.height, depth_lens.width))
        require_picture("colour", color, np.uint8, (color_lens.height, color_lens.width, 3))

    def prepare(self, depth: Depths, color: Bytes) -> tuple[Depths, Bytes, Intrinsics]:
        """depth uint16 [H, W] counts, color uint8 [H, W, 3] RGB -> depth uint16 [h, w] mm, color uint8 [h, w, 3], intrinsics.

        The arrays returned are the preparer's own and overwritten by the next call. Raises ValueError where the pictures do
        not fit the calibration.
        """
        self.require(depth, color)
        color_lens = self.calibration.color
        find_places(
            depth,
            self.calibration.depth_unit,
            self.calibration.nearest,
            self._slopes,
            self._to_level,
            self._pinhole,
            *self.shape,
            self._to_color,
            self._color_lens,
            self._distortion,
            any(color_lens.distortion),
            self._largest_square,
            color_lens.height,
            color_lens.width,
            self._color_every,
            self._cells,
            self._depths,
            self._places,
            self._color_depths,
            self._nearest,
            self._starts,
        )
        most = sort_into_cells(
            self._cells,
            self._depths,
            self._places,
            self._color_depths,
            self._nearest,
            color_lens.width,
            self._color_every,
            self._starts,
            self._ends,
            self._sample_depths,
            self._sample_places,
        )
        if most > self._ordered.shape[0]:
            self._ordered = np.empty(2 * most, np.float32)
        gather(
            self._starts,
            self._sample_depths,
            self._sample_places,
            color.reshape(-1, 3),
            self._fewest,
            self._matrix,
            self._offset,
            self._ordered,
            self._depth_out.reshape(-1),
            self._color_out.reshape(-1, 3),
        )
        return self._depth_out, self._color_out, self.intrinsics


def level_rotation(tilt: float) -> npt.NDArray[np.float64]:
    """From the frame of a camera that looks down by `tilt` rad to the level frame, float64 [3, 3]."""
    cosine, sine = math.cos(tilt), math.sin(tilt)
    return np.array([[1.0, 0.0, 0.0], [0.0, cosine, sine], [0.0, -sine, cosine]])


def require_picture(name: str, picture: npt.NDArray[np.generic], kind: type[np.generic], shape: tuple[int, ...]) -> None:
    """Raise ValueError unless a picture has this dtype, this shape and C order."""
    if picture.dtype != kind or picture.shape != shape:
        raise ValueError(
            f"the {name} picture must be {np.dtype(kind)} {list(shape)} as in the calibration, got {picture.dtype} "
            f"{list(picture.shape)}: set the camera to the calibrated resolution or calibrate it anew"
        )
    if not picture.flags.c_contiguous:
        raise ValueError(f"the {name} picture must lie in C order; pass np.ascontiguousarray(picture)")


def prepare(
    depth: Depths, color: Bytes, calibration: RgbdCalibration, width: int = PUBLISHED_WIDTH, height: int = PUBLISHED_HEIGHT
) -> tuple[Depths, Bytes, Intrinsics]:
    """As `RgbdPreparer.prepare`, into fresh arrays; for callers with one picture."""
    return RgbdPreparer(calibration, width, height).prepare(depth, color)
