"""Drawing on an overhead picture what the tracker makes of it: tags, the arena's border, goals, robots, boxes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from schemas import Box
from vantage.tracking.overhead_camera import OverheadCamera
from vantage.tracking.table import Table
from vantage.tracking.tags import FoundTag
from vantage.world.arena import GOALS, HIDER_COLOR, ROBOT_RADIUS, SEEKER_COLOR

Picture = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float64]
Color = tuple[int, int, int]

ROBOT_COLORS: Final[dict[str, Color]] = {"hider": HIDER_COLOR, "seeker": SEEKER_COLOR}
_BORDER: Final[Color] = (0, 200, 255)
_GOAL: Final[Color] = (255, 255, 255)
_TAG: Final[Color] = (255, 200, 0)
_BOX: Final[Color] = (190, 120, 255)
_SHIFT: Final = 4
"""Bits of a pixel's fraction in OpenCV's drawing."""


class Canvas:
    """A picture being annotated.

    Args:
        picture: uint8 [H, W, 3] RGB, or grey [H, W]; copied.
        camera: calibrated; None: nothing of the arena can be projected.
    """

    def __init__(self, picture: Picture, camera: OverheadCamera | None = None) -> None:
        self.picture: Picture = (
            np.asarray(cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB), dtype=np.uint8) if picture.ndim == 2 else picture.copy()
        )
        self._camera = camera
        self._thick = max(1, round(picture.shape[1] / 900))

    def tags(self, found: Iterable[FoundTag], names: dict[int, str]) -> None:
        """Outline tags, their own x side thick, with id and name."""
        for tag in found:
            self._pixels(tag.corners, _TAG, closed=True)
            # The side from the upper right to the lower right corner: where the tag's own x axis points.
            self._pixels(tag.corners[1:3], _TAG, thick=3)
            self.words(f"{tag.id} {names.get(tag.id, '?')}", tag.corners.max(axis=0) + 6.0, _TAG)

    def arena(self, table: Table) -> None:
        """Draw border and goals where the calibration sees them on the floor, and both axes from the origin."""
        width, depth = table.width, table.depth
        corners = ((0.0, 0.0), (width, 0.0), (width, depth), (0.0, depth))
        self.floor(corners, 0.0, _BORDER, closed=True)
        self.floor(((0.0, 0.0), (0.15, 0.0)), 0.0, (255, 60, 60), thick=3)
        self.floor(((0.0, 0.0), (0.0, 0.15)), 0.0, (60, 220, 60), thick=3)
        inside = GOALS[(GOALS[:, 0] < width) & (GOALS[:, 1] < depth)]
        for x, y in self._project(np.column_stack((inside, np.zeros(len(inside))))):
            self._dot(float(x), float(y), 2, _GOAL)
        for label, place in (("x", (0.18, 0.0)), ("y", (0.0, 0.18))):
            self.words(label, self._project(np.array([[*place, 0.0]]))[0], _BORDER)

    def robot(self, name: str, x: float, y: float, heading: float, height: float) -> None:
        """Draw a robot: its disc on the floor, and its heading at the height of its tag, m."""
        color = ROBOT_COLORS.get(name, _TAG)
        around = np.linspace(0.0, 2.0 * math.pi, 49)
        self.floor(
            [(x + ROBOT_RADIUS * math.cos(a), y + ROBOT_RADIUS * math.sin(a)) for a in around], 0.0, color, thick=2, closed=True
        )
        tip = (x + 1.4 * ROBOT_RADIUS * math.cos(heading), y + 1.4 * ROBOT_RADIUS * math.sin(heading))
        self.floor(((x, y), tip), height, color, thick=3)

    def box(self, box: Box) -> None:
        """Draw a box: its top, and its foot on the floor."""
        cosine, sine = math.cos(box.heading), math.sin(box.heading)
        corners = [
            (box.x + cosine * a - sine * b, box.y + sine * a + cosine * b)
            for a, b in (
                (-box.half_width, -box.half_depth),
                (box.half_width, -box.half_depth),
                (box.half_width, box.half_depth),
                (-box.half_width, box.half_depth),
            )
        ]
        self.floor(corners, 0.0, _BOX, closed=True)
        self.floor(corners, box.height, _BOX, thick=2, closed=True)

    def floor(
        self, points: Sequence[tuple[float, float]], height: float, color: Color, *, thick: int = 1, closed: bool = False
    ) -> None:
        """Draw a line through points x, y (m) at a height, bent as the lens bends it."""
        path = np.array([*points, points[0]] if closed else points, dtype=np.float64)
        steps = np.linspace(0.0, len(path) - 1.0, 12 * (len(path) - 1) + 1)
        places = np.arange(len(path), dtype=np.float64)
        fine = np.column_stack(
            (np.interp(steps, places, path[:, 0]), np.interp(steps, places, path[:, 1]), np.full(len(steps), height))
        )
        self._pixels(self._project(fine), color, thick=thick)

    def words(self, text: str, place: Floats | tuple[float, float], color: Color) -> None:
        """Write a text with its lower left corner at a place, px; dark behind it so that it reads on anything."""
        size = 0.4 * self._thick
        (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, self._thick)
        x = round(min(max(float(place[0]), 2.0), self.picture.shape[1] - width - 2.0))
        y = round(min(max(float(place[1]), height + 2.0), self.picture.shape[0] - below - 2.0))
        cv2.rectangle(self.picture, (x - 2, y - height - 2), (x + width + 1, y + below), (20, 20, 20), -1)
        cv2.putText(self.picture, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, size, color, self._thick, cv2.LINE_AA)

    def rectangle(self, left: int, top: int, width: int, height: int, color: Color, label: str) -> None:
        """Frame a part of the picture, px."""
        cv2.rectangle(self.picture, (left, top), (left + width - 1, top + height - 1), (0, 0, 0), 3 * self._thick)
        cv2.rectangle(self.picture, (left, top), (left + width - 1, top + height - 1), color, self._thick)
        self.words(label, (left, top - 5), color)

    def region(self, region: npt.NDArray[np.bool_], color: Color, label: str) -> None:
        """Outline a part of the picture, bool [H, W]."""
        outlines, _ = cv2.findContours(region.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(self.picture, outlines, -1, (0, 0, 0), 3 * self._thick)
        cv2.drawContours(self.picture, outlines, -1, color, self._thick)
        rows, columns = np.nonzero(region)
        self.words(label, (float(columns.min()), float(rows.min()) - 5.0), color)

    def _project(self, points: Floats) -> Floats:
        if self._camera is None:
            raise ValueError("nothing of the arena can be drawn without a calibration")
        return self._camera.project(points)

    def _pixels(self, points: Floats, color: Color, *, thick: int = 1, closed: bool = False) -> None:
        # Far outside the picture a lens's polynomial means nothing.
        limit = 4 * max(self.picture.shape[:2])
        fixed = np.round(np.clip(points, -limit, limit) * (1 << _SHIFT)).astype(np.int32).reshape(-1, 1, 2)
        cv2.polylines(self.picture, [fixed], closed, color, thick * self._thick, cv2.LINE_AA, _SHIFT)

    def _dot(self, x: float, y: float, radius: int, color: Color) -> None:
        if 0.0 <= x < self.picture.shape[1] and 0.0 <= y < self.picture.shape[0]:
            cv2.circle(self.picture, (round(x), round(y)), radius * self._thick, color, -1, cv2.LINE_AA)


def tag_names(table: Table) -> dict[int, str]:
    """Return what each tag of a table is for, by its id."""
    return {
        **{tag.id: robot for robot, tag in table.robots.items()},
        **{tag.id: "box" for tag in table.obstacles},
        **{tag.id: "corner" for tag in table.corners},
    }
