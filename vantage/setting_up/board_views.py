"""Pictures of the ChArUco board for measuring a lens: which are worth keeping, and which are still missing."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from vantage.printable import counted
from vantage.tracking.lens import BoardDescription, charuco_board

Picture = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float64]

FEWEST_CORNERS: Final = 12
"""Corners of the board that a picture must show."""

WANTED_VIEWS: Final = 20
TILTED: Final = math.radians(18.0)
"""A board counts as tilted from here on."""

TILTED_VIEWS: Final = 2
"""Wanted with the board tilted in each direction."""

_DIFFERENT: Final = 0.05
"""A view is new when the board's corners lie this much apart on average, as a share of the picture's width."""

_PLACES: Final = (
    *("the upper left corner", "the middle of the upper edge", "the upper right corner"),
    *("the middle of the left edge", "the middle", "the middle of the right edge"),
    *("the lower left corner", "the middle of the lower edge", "the lower right corner"),
)
_TILTS: Final = ("its right side nearer", "its left side nearer", "its lower side nearer", "its upper side nearer")
_OUTER: Final = 0.22
"""Share of the width and height that counts as the picture's edge."""


@dataclass(frozen=True, slots=True)
class BoardView:
    """The board in one picture.

    Attributes:
        name: of the picture.
        picture: grey, uint8 [H, W].
        ids: of the corners found, int [n].
        corners: float64 [n, 2] px.
        tilt: rad by which the side on the right and the lower side of the picture are nearer to the camera; estimated for a
            lens of 60 degrees, good enough to ask for other views.
    """

    name: str
    picture: Picture
    ids: npt.NDArray[np.int64]
    corners: Floats
    tilt: tuple[float, float]


@dataclass
class BoardViews:
    """The views kept so far, all of one size. `offer` each picture; `missing` says what to show next."""

    board: BoardDescription = field(default_factory=BoardDescription)
    wanted: int = WANTED_VIEWS
    views: list[BoardView] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._board = charuco_board(self.board)
        self._detector = cv2.aruco.CharucoDetector(self._board)

    def offer(self, name: str, picture: Picture) -> str:
        """Keep a picture (uint8 [H, W, 3] RGB) if it is worth it; return why not, or an empty text."""
        grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        if self.views and grey.shape != self.views[0].picture.shape:
            rows, columns = self.views[0].picture.shape
            return f"it has {grey.shape[1]} x {grey.shape[0]} pixels, those before {columns} x {rows}"
        corners, ids, _, _ = self._detector.detectBoard(grey)
        if ids is None or len(ids) < FEWEST_CORNERS:
            found = 0 if ids is None else len(ids)
            return f"only {found} corners of the board are seen, {FEWEST_CORNERS} are needed: nearer, flatter, more light"
        found_ids = np.asarray(ids, dtype=np.int64).ravel()
        found_corners = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
        if any(self._alike(view, found_ids, found_corners) for view in self.views):
            return "it shows what a picture before it shows"
        tilt = self._tilt_of(found_ids, found_corners, grey.shape)
        self.views.append(BoardView(name, np.asarray(grey), found_ids, found_corners, tilt))
        return ""

    def missing(self) -> list[str]:
        """Return what still has to be shown, most wanted first; empty when all is there."""
        wishes = [f"the board in {place} of the picture" for place, seen in zip(_PLACES, self._places(), strict=True) if not seen]
        wishes += [f"the board tilted, {way}" for way, count in zip(_TILTS, self._tilts(), strict=True) if count < TILTED_VIEWS]
        if len(self.views) < self.wanted:
            more = self.wanted - len(self.views)
            wishes.append(counted(more, "more view"))
        return wishes

    def _places(self) -> list[bool]:
        seen = np.zeros(9, dtype=bool)
        for view in self.views:
            rows, columns = view.picture.shape
            column = np.digitize(view.corners[:, 0] / columns, (_OUTER, 1.0 - _OUTER))
            row = np.digitize(view.corners[:, 1] / rows, (_OUTER, 1.0 - _OUTER))
            seen[np.unique(3 * row + column)] = True
        return [bool(place) for place in seen]

    def _tilts(self) -> tuple[int, int, int, int]:
        sideways = [view.tilt[0] for view in self.views]
        upward = [view.tilt[1] for view in self.views]
        return (
            sum(tilt > TILTED for tilt in sideways),
            sum(tilt < -TILTED for tilt in sideways),
            sum(tilt > TILTED for tilt in upward),
            sum(tilt < -TILTED for tilt in upward),
        )

    def _alike(self, view: BoardView, ids: npt.NDArray[np.int64], corners: Floats) -> bool:
        _, here, there = np.intersect1d(ids, view.ids, return_indices=True)
        if len(here) < FEWEST_CORNERS // 2:
            return False
        apart = np.linalg.norm(corners[here] - view.corners[there], axis=1).mean()
        return bool(apart < _DIFFERENT * view.picture.shape[1])

    def _tilt_of(self, ids: npt.NDArray[np.int64], corners: Floats, shape: tuple[int, ...]) -> tuple[float, float]:
        rows, columns = shape[:2]
        focal = columns / (2.0 * math.tan(math.radians(30.0)))
        matrix = np.array([[focal, 0.0, columns / 2.0], [0.0, focal, rows / 2.0], [0.0, 0.0, 1.0]])
        places = np.asarray(self._board.getChessboardCorners(), dtype=np.float64)[ids]
        found, turn, _ = cv2.solvePnP(places, corners, matrix, None)
        if not found:
            return 0.0, 0.0
        normal = cv2.Rodrigues(turn)[0][:, 2]
        # Of the two faces the one that looks away from the camera; board: x right, y down, z into the board.
        normal = normal if normal[2] > 0.0 else -normal
        return math.atan2(normal[0], normal[2]), math.atan2(normal[1], normal[2])


def coverage_picture(views: BoardViews) -> Picture:
    """Return a picture of where the board was seen, uint8 [H, W, 3] RGB: outlines of its views, dots for its corners."""
    dimmed = (views.views[-1].picture // 3).astype(np.uint8)
    canvas = cv2.cvtColor(dimmed, cv2.COLOR_GRAY2RGB)
    for number, view in enumerate(views.views):
        hue = int(180 * number / max(1, len(views.views)))
        color = tuple(int(c) for c in cv2.cvtColor(np.array([[[hue, 190, 255]]], np.uint8), cv2.COLOR_HSV2RGB)[0, 0])
        outline = cv2.convexHull(view.corners.astype(np.float32)).astype(np.int32)
        cv2.polylines(canvas, [outline], True, color, 1, cv2.LINE_AA)
        for x, y in view.corners:
            cv2.circle(canvas, (round(float(x)), round(float(y))), 2, color, -1, cv2.LINE_AA)
    return np.asarray(canvas, dtype=np.uint8)
