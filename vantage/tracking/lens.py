"""The lens of a camera: measured from pictures of a ChArUco board (OpenCV's pinhole with five distortion terms)."""

from __future__ import annotations

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
    raise CalibrationFailed("not yet")
