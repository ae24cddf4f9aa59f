"""The calibration of the overhead camera: lens and place over the arena. File `overhead.json`."""

from __future__ import annotations

import datetime
import math
from pathlib import Path

import cv2
import msgspec
import numpy as np
import numpy.typing as npt

from vantage.output import write_complete
from vantage.tracking.errors import CalibrationFailed, UnusableCalibration
from vantage.tracking.lens import GREATEST_LENS_RESIDUAL, BoardDescription, Lens, LensResult, calibrate_lens
from vantage.tracking.overhead_camera import Calibration, OverheadCamera
from vantage.tracking.table import MAXIMUM_FILE_SIZE, Table
from vantage.tracking.tag_pose import mounted_corners
from vantage.tracking.tags import TagFinder, distinct

__all__ = ["BoardDescription", "Calibration", "Lens", "LensResult", "calibrate_arena", "calibrate_lens", "load_calibration"]

Picture = npt.NDArray[np.uint8]

OLDEST_DAYS = 90
GREATEST_ARENA_RESIDUAL = 3.0
"""mm, root mean square of the corner tags' corners on the floor."""


def load_calibration(path: Path, width: int, height: int, today: datetime.date, oldest_days: int = OLDEST_DAYS) -> Calibration:
    """Read a calibration and refuse one that must not be used.

    Raises:
        UnusableCalibration: missing, malformed, of another resolution, older than so many days, residuals above the limits.
    """
    again = "calibrate again with `vantage table calibrate`"
    try:
        if path.stat().st_size > MAXIMUM_FILE_SIZE:
            raise UnusableCalibration(f"{path} is not a calibration: it has more than {MAXIMUM_FILE_SIZE} bytes; {again}")
        found = msgspec.json.decode(path.read_bytes(), type=Calibration)
    except OSError as error:
        raise UnusableCalibration(f"cannot read the calibration {path}: {error.strerror}; {again}") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UnusableCalibration(f"{path} is not a calibration: {error}; {again}") from error
    if (found.width, found.height) != (width, height):
        raise UnusableCalibration(
            f"{path} is for pictures of {found.width} x {found.height}, the camera gives {width} x {height}: "
            f"set the camera to the calibrated resolution or {again}"
        )
    age = (today - found.date).days
    if age > oldest_days:
        raise UnusableCalibration(f"{path} is {age} days old, {oldest_days} are allowed: {again}")
    if age < -1:
        raise UnusableCalibration(f"{path} is of {found.date}, which is yet to come: set the clock or {again}")
    if found.lens_residual > GREATEST_LENS_RESIDUAL:
        raise UnusableCalibration(
            f"{path} has a lens residual of {found.lens_residual:.2f} px, {GREATEST_LENS_RESIDUAL} are allowed: {again}"
        )
    if found.arena_residual > GREATEST_ARENA_RESIDUAL:
        raise UnusableCalibration(
            f"{path} has an arena residual of {found.arena_residual:.1f} mm, {GREATEST_ARENA_RESIDUAL} are allowed: {again}"
        )
    reason = _impossible(found)
    if reason:
        raise UnusableCalibration(f"{path} is damaged: {reason}; {again}")
    return found


def _impossible(calibration: Calibration) -> str:
    """Why no camera over a table can have this calibration, empty when one can."""
    numbers = (*calibration.matrix, *calibration.distortion, *calibration.rotation, *calibration.translation)
    if not all(math.isfinite(number) for number in numbers):
        return "a number is not finite"
    matrix = calibration.matrix
    if matrix[0] <= 0 or matrix[4] <= 0 or any(matrix[i] for i in (1, 3, 6, 7)) or matrix[8] != 1:
        return "the matrix is not that of a pinhole"
    if not (0 < matrix[2] < calibration.width and 0 < matrix[5] < calibration.height):
        return "the optical axis is outside the picture"
    rotation = np.array(calibration.rotation).reshape(3, 3)
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
        return "the rotation is none"
    if (-rotation.T @ np.array(calibration.translation))[2] <= 0:
        return "the camera is below the floor"
    return ""


def save_calibration(calibration: Calibration, path: Path) -> None:
    """Write a calibration, replacing the file at once."""
    write_complete(path, msgspec.json.format(msgspec.json.encode(calibration), indent=2) + b"\n")


def calibrate_arena(picture: Picture, table: Table, lens: Lens, date: datetime.date, made_with: str = "") -> Calibration:
    """Find the camera's place over the arena from one picture of the corner tags.

    The tags' corners are undistorted and the camera's full pose follows by `cv2.solvePnP` (planar start, Levenberg-Marquardt),
    so that a plane at any height is known.

    Args:
        picture: uint8 [H, W] or [H, W, 3] RGB, of the lens's resolution.
        table: whose corner tags are in the picture; at least four, and all that it names.
        lens: measured before, at the same resolution and focus.
        date: of today, kept in the calibration.
        made_with: how, kept in the calibration.

    Raises:
        CalibrationFailed: wrong resolution, corner tags not seen or seen twice, or they do not lie where the table says.
    """
    height, width = picture.shape[:2]
    if (width, height) != (lens.width, lens.height):
        raise CalibrationFailed(
            f"the picture is {width} x {height}, the lens was measured at {lens.width} x {lens.height}: use the same resolution"
        )
    seen = distinct(TagFinder().find(picture, (0, 0, width, height), half=False))
    ids = [tag.id for tag in seen]
    missing = [str(tag.id) for tag in table.corners if tag.id not in ids]
    if missing:
        raise CalibrationFailed(
            f"corner tag {', '.join(missing)} not seen: is it in the picture, flat, lit evenly, and nothing on it? "
            f"(seen: {', '.join(map(str, sorted(ids))) or 'no tag at all'})"
        )
    twice = [str(tag.id) for tag in table.corners if ids.count(tag.id) > 1]
    if twice:
        raise CalibrationFailed(f"corner tag {', '.join(twice)} seen more than once: take the copies away")
    by_id = {tag.id: tag.corners for tag in seen}
    pixels = np.concatenate([by_id[tag.id] for tag in table.corners])
    floor = np.concatenate([mounted_corners(table.corner_size, tag.x, tag.y, tag.heading) for tag in table.corners])
    places = np.column_stack((floor, np.zeros(len(floor))))
    matrix, distortion = np.array(lens.matrix).reshape(3, 3), np.array(lens.distortion)
    solved, turn, shift = cv2.solvePnP(places, pixels, matrix, distortion, flags=cv2.SOLVEPNP_IPPE)
    if not solved:
        raise CalibrationFailed("the corner tags give no place of the camera: check their places in the table's file")
    turn, shift = cv2.solvePnPRefineLM(places, pixels, matrix, distortion, turn, shift)
    rotation = cv2.Rodrigues(turn)[0]
    found = Calibration(
        width=width,
        height=height,
        matrix=lens.matrix,
        distortion=lens.distortion,
        rotation=tuple(rotation.ravel().tolist()),
        translation=tuple(np.asarray(shift).ravel().tolist()),
        lens_residual=lens.residual,
        arena_residual=0.0,
        date=date,
        made_with=made_with,
    )
    back, _ = OverheadCamera(found).on_plane(pixels, 0.0)
    errors = np.linalg.norm(back - floor, axis=1).reshape(-1, 4)
    residual = 1000.0 * float(np.sqrt((errors**2).mean()))
    found = msgspec.structs.replace(found, arena_residual=residual)
    if residual > GREATEST_ARENA_RESIDUAL:
        worst = table.corners[int(errors.mean(axis=1).argmax())].id
        raise CalibrationFailed(
            f"the corner tags lie {residual:.1f} mm from where the table says, {GREATEST_ARENA_RESIDUAL} are allowed: measure "
            f"their places again (tag {worst} fits worst), and their size ({table.corner_size * 1000:.0f} mm?)"
        )
    reason = _impossible(found)
    if reason:
        raise CalibrationFailed(f"{reason}: check the places of the corner tags in the table's file")
    return found
