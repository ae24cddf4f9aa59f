"""The lens of a camera: measured from pictures of a ChArUco board (OpenCV's pinhole with five distortion terms)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import cv2
import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Meta

from vantage.tracking.errors import CalibrationFailed

Floats = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

FEWEST_VIEWS = 8
FEWEST_CORNERS = 8
"""of the board in a picture"""
FEWEST_TILTED = 3
TILTED = 0.04
"""Change of the distance over the board, as a share of it, from which a board counts as tilted."""
GREATEST_FOCAL_DEVIATION = 0.02
"""Standard deviation of the focal length as a share of it: more says that the pictures do not settle it."""
GREATEST_LENS_RESIDUAL = 0.5
"""px, root mean square: more says that the board is bent or the pictures are blurred."""


class Lens(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A pinhole and its distortion, OpenCV's conventions: integer pixel coordinates are pixel centres."""

    width: Annotated[int, Meta(ge=16, le=16384, description="px")]
    height: Annotated[int, Meta(ge=16, le=16384, description="px")]
    matrix: Annotated[tuple[float, ...], Meta(min_length=9, max_length=9, description="3 x 3 by rows, px")]
    distortion: Annotated[tuple[float, ...], Meta(min_length=5, max_length=5, description="k1, k2, p1, p2, k3")]
    residual: Annotated[float, Meta(ge=0.0, description="px, root mean square over all corners of all views")]
    views: Annotated[int, Meta(ge=0, description="pictures of the board that were used")] = 0


class BoardDescription(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A ChArUco board; the default fits on a sheet of A4."""

    columns: int = 8
    rows: int = 5
    square: float = 0.034
    """side of a square, m"""
    marker: float = 0.025
    """side of a marker, m"""
    dictionary: int = cv2.aruco.DICT_5X5_100
    """other markers than the table's tags"""


@dataclass(frozen=True, slots=True)
class LensResult:
    """A measured lens, and the pictures that were refused: index and why."""

    lens: Lens
    refused: tuple[tuple[int, str], ...]


def charuco_board(board: BoardDescription) -> Any:
    """Return OpenCV's board."""
    dictionary = cv2.aruco.getPredefinedDictionary(board.dictionary)
    return cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker, dictionary)


def calibrate_lens(
    pictures: Sequence[Picture], board: BoardDescription | None = None, fewest_views: int = FEWEST_VIEWS
) -> LensResult:
    """Measure a lens from pictures of the board held at different places and tilts.

    Args:
        pictures: uint8 [H, W] or [H, W, 3] RGB, all of one size.
        board: that was photographed, default that of `vantage table print`.
        fewest_views: good ones needed.

    Raises:
        CalibrationFailed: too few good views, views too much alike, or the fit is bad.
    """
    board = board or BoardDescription()
    if not pictures:
        raise CalibrationFailed("no pictures of the board: take at least " + str(fewest_views))
    height, width = pictures[0].shape[:2]
    detector = cv2.aruco.CharucoDetector(charuco_board(board))
    places: Floats = np.asarray(charuco_board(board).getChessboardCorners(), dtype=np.float64)
    gap = (board.square - board.marker) / 2 / board.square
    views: list[_View] = []
    refused: list[tuple[int, str]] = []
    for index, picture in enumerate(pictures):
        view = _look(index, picture, (height, width), detector, places, gap)
        reason = view if isinstance(view, str) else _why_not(view, views, (width, height))
        if isinstance(view, str) or reason:
            refused.append((index, str(reason)))
        else:
            views.append(view)
    _require_views(views, fewest_views, refused)
    fit = _fit(views, (width, height))
    # A picture that does not fit the others (board moved, board bent) is left out and the rest fitted again.
    bad = [view for view, error in zip(views, fit.errors, strict=True) if error > max(3 * float(np.median(fit.errors)), 0.3)]
    if bad:
        refused += [(view.index, "does not fit the other pictures: the board moved or was blurred") for view in bad]
        views = [view for view in views if view not in bad]
        _require_views(views, fewest_views, refused)
        fit = _fit(views, (width, height))
    if fit.residual > GREATEST_LENS_RESIDUAL:
        raise CalibrationFailed(
            f"the lens does not fit: {fit.residual:.2f} px residual, {GREATEST_LENS_RESIDUAL} allowed; "
            "mount the board on something flat, hold it still, and check its measures"
        )
    lens = Lens(
        width=width,
        height=height,
        matrix=tuple(fit.matrix.ravel().tolist()),
        distortion=tuple(fit.distortion.ravel().tolist()[:5]),
        residual=fit.residual,
        views=len(views),
    )
    return LensResult(lens, tuple(sorted(refused)))


@dataclass(frozen=True, eq=False)
class _View:
    """Corners of the board in one picture: pixels float32 [n, 2], places on the board float32 [n, 3], ids int [n]."""

    index: int
    pixels: npt.NDArray[np.float32]
    places: npt.NDArray[np.float32]
    ids: npt.NDArray[np.int64]


@dataclass(frozen=True)
class _Fit:
    residual: float
    matrix: Floats
    distortion: Floats
    errors: Floats


def _look(index: int, picture: Picture, size: tuple[int, int], detector: Any, places: Floats, gap: float) -> _View | str:
    """The board's corners in a picture, or why there are none."""
    if picture.shape[:2] != size:
        return f"is {picture.shape[1]} x {picture.shape[0]}, the first picture {size[1]} x {size[0]}"
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) if picture.ndim == 3 else picture
    corners, ids, _, _ = detector.detectBoard(grey)
    if ids is None or len(ids) == 0:
        return "shows no board"
    ids = np.asarray(ids, dtype=np.int64).ravel()
    if len(ids) < FEWEST_CORNERS:
        return f"shows {len(ids)} corners of the board, {FEWEST_CORNERS} are needed"
    if np.linalg.matrix_rank(places[ids, :2] - places[ids, :2].mean(axis=0), tol=1e-6) < 2:
        return "shows corners of a single row only"
    pixels = _refined(grey, np.asarray(corners, np.float32).reshape(-1, 2), gap)
    return _View(index, pixels, places[ids].astype(np.float32), ids)


def _refined(grey: Picture, pixels: npt.NDArray[np.float32], gap: float) -> npt.NDArray[np.float32]:
    """Corners float32 [n, 2] to a few hundredths of a pixel.

    OpenCV's own refinement of the board reaches into the markers where these are small, which draws corners away by 0.3 px:
    the window here ends well before them. gap is the white around a marker as a share of a square.
    """
    between = np.linalg.norm(pixels[:, None] - pixels[None], axis=-1)
    square = float(np.median(np.where(between > 0, between, np.inf).min(axis=1)))
    half = int(np.clip(0.6 * gap * square, 2, 8))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.001)
    refined = cv2.cornerSubPix(grey, pixels.reshape(-1, 1, 2).copy(), (half, half), (-1, -1), criteria)
    return np.asarray(refined, np.float32).reshape(-1, 2)


def _why_not(view: _View, others: Sequence[_View], size: tuple[int, int]) -> str:
    """Why a view adds nothing, empty when it does."""
    for other in others:
        _, mine, theirs = np.intersect1d(view.ids, other.ids, return_indices=True)
        if len(mine) and float(np.linalg.norm(view.pixels[mine] - other.pixels[theirs], axis=1).mean()) < 0.01 * size[0]:
            return f"shows the board just as picture {other.index} does: move it"
    return ""


def _require_views(views: Sequence[_View], fewest: int, refused: Sequence[tuple[int, str]]) -> None:
    if len(views) < fewest:
        reasons = "; ".join(f"picture {index} {reason}" for index, reason in sorted(refused)[:4])
        raise CalibrationFailed(
            f"{len(views)} good pictures of the board, {fewest} are needed: take more, at other places and tilts"
            + (f" ({reasons})" if reasons else "")
        )
    # Without tilt a near lens and a far one give the same pictures, and the fit may settle on either.
    tilted = sum(_foreshortening(view) > TILTED for view in views)
    if tilted < FEWEST_TILTED:
        raise CalibrationFailed(
            f"{tilted} pictures show the board tilted, {FEWEST_TILTED} are needed: tilt it by 20 to 40 degrees in half of them"
        )


def _foreshortening(view: _View) -> float:
    """Change of the distance over the board, as a share of it: the perspective part of the map from board to picture."""
    middle, reach = view.places[:, :2].mean(axis=0), float(np.ptp(view.places[:, :2], axis=0).max())
    homography, _ = cv2.findHomography((view.places[:, :2] - middle) / reach, view.pixels)
    return 0.0 if homography is None else float(np.hypot(homography[2, 0], homography[2, 1]) / abs(homography[2, 2]))


def _fit(views: Sequence[_View], size: tuple[int, int]) -> _Fit:
    """Fit the lens (Zhang's method, `cv2.calibrateCamera`)."""
    result = cv2.calibrateCameraExtended(
        [view.places for view in views], [view.pixels for view in views], size, np.eye(3), np.zeros(5)
    )
    residual, matrix, distortion, _, _, deviations, _, errors = result
    focal_deviation = float(np.asarray(deviations).ravel()[0])
    if not math.isfinite(residual) or focal_deviation > GREATEST_FOCAL_DEVIATION * float(matrix[0, 0]):
        raise CalibrationFailed("the pictures do not settle the lens: take more, tilted, up to the picture's corners")
    return _Fit(float(residual), matrix, distortion, np.asarray(errors, dtype=np.float64).ravel())
