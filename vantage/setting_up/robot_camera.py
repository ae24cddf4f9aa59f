"""A robot's RGB-D camera: its lenses as the maker measured them, its height and tilt from the floor that it sees."""

from __future__ import annotations

import datetime
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import msgspec
import numpy as np
import numpy.typing as npt

from vantage.setting_up.trouble import TableTrouble
from vantage.tracking.colors import ColorCorrection
from vantage.tracking.picture_file import read_arrays
from vantage.tracking.realsense import load_library, open_realsense, stop_realsense
from vantage.tracking.rgbd import RgbdCalibration, default_rgbd, load_rgbd, save_rgbd
from vantage.tracking.rgbd_lens import Lens, pixel_rays
from vantage.tracking.video_capture import UnusableCamera

Depths = npt.NDArray[np.uint16]
Floats = npt.NDArray[np.float64]

FARTHEST: Final = 1.0
"""m: of the floor beyond, a stereo camera's depth says little about the tilt."""
FEWEST_POINTS: Final = 2000
_STRAY: Final = 0.012
"""m from the plane at which a point does not count as floor any more."""
GREATEST_SPREAD: Final = 0.006
"""m (RMS) by which a floor may be uneven to a camera."""
GREATEST_REMAINDER: Final = 0.5
"""px that a distortion may be off where it is turned round."""
GREATEST_ROLL: Final = math.radians(2.0)
LARGEST_TILT: Final = math.radians(30.0)
HEIGHTS: Final = (0.03, 0.30)
"""m between which a robot's camera can be."""
_FRAMES: Final = 30


@dataclass(frozen=True, slots=True)
class Mount:
    """How a camera sits on its robot.

    Attributes:
        height: of the depth lens above the floor, m.
        tilt: by which it looks down, rad.
        roll: by which it leans to its right, rad; ought to be 0, nothing corrects it.
        spread: root mean square distance of the floor's points from their plane, m.
        points: of the floor.
    """

    height: float
    tilt: float
    roll: float
    spread: float
    points: int


def measure_mount(depth: Depths, calibration: RgbdCalibration) -> Mount:
    """Fit a plane to the floor that a camera sees: least squares, strays left out until nothing changes (trimmed fit).

    Args:
        depth: uint16 [H, W] counts of a robot that stands on free floor.

    Raises:
        TableTrouble: the picture is of another size, there is too little floor in it, or it cannot be floor.
    """
    lens = calibration.depth
    if depth.shape != (lens.height, lens.width):
        raise TableTrouble(
            f"the depth picture has {depth.shape[1]} x {depth.shape[0]} pixels, its lens is for {lens.width} x {lens.height}"
        )
    z = depth * calibration.depth_unit
    rays = pixel_rays(lens)
    points = np.stack((rays[..., 0] * z, rays[..., 1] * z, z), axis=-1)  # [H, W, 3], x right, y down, z forward
    # The floor is what lies lowest, column by column: what stands on it ends above.
    low = np.zeros(depth.shape, dtype=bool)
    low[2 * lens.height // 3 :] = True
    floor = points[low & (z > 0.0) & (z < FARTHEST)]
    plane = np.zeros(3)
    kept = floor
    for _ in range(12):
        if len(kept) < FEWEST_POINTS:
            break
        # y = a x + b + c z: the floor is never upright before a camera on a robot.
        design = np.column_stack((kept[:, 0], np.ones(len(kept)), kept[:, 2]))
        plane = np.linalg.lstsq(design, kept[:, 1], rcond=None)[0]
        off = np.abs(floor @ np.array([plane[0], -1.0, plane[2]]) + plane[1])
        again = floor[off < max(_STRAY, 1.5 * float(np.median(off)))]
        if len(again) == len(kept):
            break
        kept = again
    if len(kept) < FEWEST_POINTS:
        raise TableTrouble(
            f"only {len(kept)} points of floor within {FARTHEST:g} m: put the robot on the table with free floor before it"
        )
    slope, below, fall = (float(value) for value in plane)
    length = math.sqrt(1.0 + slope * slope + fall * fall)
    residual = (kept @ np.array([slope, -1.0, fall]) + below) / length
    # A camera that looks down by a tilt sees the floor rise in its picture: y grows less with z.
    mount = Mount(below / length, -math.atan(fall), math.atan(slope), float(np.sqrt(np.mean(residual * residual))), len(kept))
    likely = HEIGHTS[0] <= mount.height <= HEIGHTS[1] and abs(mount.tilt) <= LARGEST_TILT and mount.spread <= GREATEST_SPREAD
    if not likely:
        raise TableTrouble(
            f"what fills the lower third of the picture is no floor (its plane would be {1000 * mount.height:.0f} mm below the "
            f"lens, tilted {math.degrees(mount.tilt):.0f}°, {1000 * mount.spread:.0f} mm rough): "
            "put the robot on the table with free floor before it"
        )
    if abs(mount.roll) > GREATEST_ROLL:
        raise TableTrouble(
            f"the camera leans sideways by {math.degrees(mount.roll):.1f}°: level it on its robot, "
            f"to {math.degrees(GREATEST_ROLL):g}°, and measure again"
        )
    return mount


def read_depth(path: Path) -> Depths:
    """Read a recorded depth picture: `*.npz` with an array `depth`, or a 16-bit PNG. Returns uint16 [H, W] counts.

    Raises:
        TableTrouble, UnreadableArrays: there is none.
    """
    if not path.is_file():
        raise TableTrouble(f"there is no depth picture {path}: give realsense, realsense:SERIAL, a *.npz or a 16-bit *.png")
    if path.suffix == ".npz":
        depth: npt.NDArray[Any] | None = read_arrays(path, "depth")[0]
    else:
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if depth is None or depth.ndim != 2 or depth.dtype != np.uint16:
        raise TableTrouble(f"{path} is no depth picture: it must be uint16, one channel")
    return np.asarray(depth, dtype=np.uint16)


def read_realsense(serial: str, width: int, height: int) -> tuple[RgbdCalibration, Depths]:
    """Ask a RealSense for its makers' calibration, and take a depth picture (median of 30).

    Raises:
        TableTrouble: no such camera, or the package pyrealsense2 is not installed.
    """
    try:
        library = load_library()
        pipeline, profile = open_realsense(library, serial, width, height)
    except UnusableCamera as error:
        raise TableTrouble(str(error)) from error
    try:
        frames = [np.asanyarray(pipeline.wait_for_frames().get_depth_frame().get_data()).copy() for _ in range(_FRAMES)]
        return realsense_calibration(library, profile), np.median(np.stack(frames), axis=0).astype(np.uint16)
    except RuntimeError as error:
        raise TableTrouble(f"the RealSense gives no frames any more ({error}): look at its cable") from error
    finally:
        stop_realsense(pipeline)


def realsense_calibration(library: Any, profile: Any) -> RgbdCalibration:
    """Translate what pyrealsense2 says of its lenses."""
    depth = profile.get_stream(library.stream.depth).as_video_stream_profile()
    color = profile.get_stream(library.stream.color).as_video_stream_profile()
    between = depth.get_extrinsics_to(color)
    across, down, along = between.translation
    return RgbdCalibration(
        depth=_lens(depth.get_intrinsics()),
        color=_lens(color.get_intrinsics()),
        # librealsense stores the rotation by columns.
        rotation=tuple(np.array(between.rotation).reshape(3, 3).T.ravel().tolist()),
        translation=(float(across), float(down), float(along)),
        depth_unit=float(profile.get_device().first_depth_sensor().get_depth_scale()),
        made_with=f"RealSense {profile.get_device().get_info(library.camera_info.serial_number)}",
    )


def mounted(calibration: RgbdCalibration, mount: Mount, forward: float, left: float, today: datetime.date) -> RgbdCalibration:
    """Return a calibration with the mount that was measured; `forward` and `left` of the robot's centre in m."""
    return msgspec.structs.replace(
        calibration, mount_height=mount.height, tilt=mount.tilt, forward=forward, left=left, date=today.isoformat()
    )


def lenses_of(path: Path | None) -> RgbdCalibration:
    """Return the lenses of a recorded camera: of a file, or those of the rehearsal's camera."""
    return default_rgbd() if path is None else load_rgbd(path)


def load_or_refuse(path: Path, robot: str) -> RgbdCalibration:
    """Read a robot's file.

    Raises:
        TableTrouble: there is none yet.
        UnusableRgbdCalibration: it is damaged.
    """
    if not path.is_file():
        raise TableTrouble(f"there is no {path} yet: `vantage table calibrate robot --robot {robot}` writes it, then come back")
    return load_rgbd(path)


def save_correction(calibration: RgbdCalibration, correction: ColorCorrection, path: Path) -> None:
    """Write a robot's file with another colour correction."""
    save_rgbd(msgspec.structs.replace(calibration, correction=correction), path)


def _lens(intrinsics: Any) -> Lens:
    coefficients = np.zeros(5)
    coefficients[: len(intrinsics.coeffs)] = intrinsics.coeffs
    lens = Lens(
        width=int(intrinsics.width),
        height=int(intrinsics.height),
        fx=float(intrinsics.fx),
        fy=float(intrinsics.fy),
        cx=float(intrinsics.ppx),
        cy=float(intrinsics.ppy),
    )
    if "inverse" in str(intrinsics.model):
        coefficients = forward_distortion(coefficients, lens)
    first, second, third, fourth, fifth = (float(value) for value in coefficients)
    return msgspec.structs.replace(lens, distortion=(first, second, third, fourth, fifth))


def forward_distortion(inverse: Floats, lens: Lens) -> Floats:
    """Return OpenCV's coefficients k1, k2, p1, p2, k3 for a lens whose maker gives them for the way back.

    librealsense's "inverse Brown-Conrady" takes a pixel to its ray by the polynomial that OpenCV takes a ray to its pixel by.
    The coefficients enter linearly, so that least squares over the picture finds them.

    Args:
        inverse: float64 [5].
        lens: without distortion.

    Raises:
        TableTrouble: no such coefficients are near enough.
    """
    u, v = np.meshgrid(np.linspace(0, lens.width - 1, 41), np.linspace(0, lens.height - 1, 31))
    seen = np.column_stack((((u - lens.cx) / lens.fx).ravel(), ((v - lens.cy) / lens.fy).ravel()))  # [n, 2]
    ray = seen + np.einsum("nij,j->ni", _distortion_terms(seen), inverse)
    terms = _distortion_terms(ray).reshape(-1, 5)
    forward = np.asarray(np.linalg.lstsq(terms, (seen - ray).ravel(), rcond=None)[0], dtype=np.float64)
    left = float(np.abs(terms @ forward - (seen - ray).ravel()).max()) * lens.fx
    if left > GREATEST_REMAINDER:
        raise TableTrouble(
            f"the maker's distortion {inverse.tolist()} cannot be turned round to {GREATEST_REMAINDER:g} px "
            f"({left:.1f} px are left): calibrate the camera with the maker's tool"
        )
    return forward


def _distortion_terms(points: Floats) -> Floats:
    """What each of k1, k2, p1, p2, k3 adds to x and y: float64 [n, 2] -> [n, 2, 5]."""
    x, y = points[:, 0], points[:, 1]
    square = x * x + y * y
    across = (x * square, x * square**2, 2 * x * y, square + 2 * x * x, x * square**3)
    down = (y * square, y * square**2, square + 2 * y * y, 2 * x * y, y * square**3)
    return np.stack((np.stack(across, axis=1), np.stack(down, axis=1)), axis=1)
