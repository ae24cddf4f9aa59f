"""What the overhead camera of a rehearsed table sees: true perspective, lens, light, blur and noise, tags and all.

The picture of the floor, walls, boxes and their tags is kept while they stand still; a frame renders only the robots' patches.
"""

from __future__ import annotations

import datetime
import math
from dataclasses import dataclass

import cv2
import msgspec
import numpy as np
import numpy.typing as npt

from schemas import Box
from vantage.rehearsal.overhead_light import Development, OverheadLook
from vantage.rehearsal.overhead_rays import COVER, DARK, LIGHT, MOMENTS, expose_window
from vantage.tracking.calibration import Calibration
from vantage.tracking.overhead_camera import OverheadCamera
from vantage.tracking.table import TAG_CELLS, CornerTag, ObstacleTag, Table, check_table
from vantage.tracking.tag_pose import mounted_corners
from vantage.tracking.tags import tag_cells
from vantage.world.arena import (
    BACKGROUND_COLOR,
    BOX_COLOR,
    FLOOR_COLOR,
    HIDER_COLOR,
    ROBOT_HEIGHT,
    ROBOT_RADIUS,
    SEEKER_COLOR,
    WALL_COLOR,
)
from vantage.world.layout import boxes_array

Floats = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

ROBOTS = ("hider", "seeker")
"""Rows of every array over both robots."""

_PLATE = (TAG_CELLS + 2) / TAG_CELLS
_KEPT_BACKGROUNDS = 4

FIRST_BOX_TAG = 10
"""Id of the tag on the first box of `table_of_layout`."""


@dataclass(frozen=True)
class _Background:
    """What stands still.

    Attributes:
        sharp: before blur and light, float32 [H, W, 3].
        light: after both, int16 [H, W, 3] in sixteenths of a grey level.
        boxes: float64 [n, 7].
        box_windows: left, top, right, bottom in the picture, float64 [n, 4] px.
        plates: tags, float64 [p, 6], see `color_at`.
        plate_cells: uint8 [p, 10, 10].
        plate_windows: float64 [p, 4] px.
    """

    sharp: npt.NDArray[np.float32]
    light: npt.NDArray[np.int16]
    boxes: Floats
    box_windows: Floats
    plates: Floats
    plate_cells: Picture
    plate_windows: Floats


def rehearsal_camera(
    width: int = 1280,
    height: int = 720,
    above: float = 1.6,
    tilt: tuple[float, float] = (0.01, -0.015),
    distortion: tuple[float, float, float, float, float] = (-0.12, 0.04, 4e-4, -3e-4, 0.0),
    arena: tuple[float, float] = (1.2, 1.2),
    date: datetime.date | None = None,
) -> Calibration:
    """Return the true lens and place of a camera above the middle of the arena, picture's top along y.

    Args:
        width: of the picture, px.
        height: of the picture, px; 1.28 m of the floor fill it from 1.6 m.
        above: the floor, m.
        tilt: about the picture's axes, rad.
        distortion: k1, k2, p1, p2, k3.
        arena: width and depth, m.
        date: of the calibration, default the first day of 2000.
    """
    focal = 1.25 * height
    rotation = cv2.Rodrigues(np.array([tilt[0], tilt[1], 0.0]))[0] @ np.diag([1.0, -1.0, -1.0])
    centre = np.array([arena[0] / 2, arena[1] / 2, above])
    return Calibration(
        width=width,
        height=height,
        matrix=(focal, 0.0, (width - 1) / 2 + 5.0, 0.0, focal, (height - 1) / 2 - 4.0, 0.0, 0.0, 1.0),
        distortion=distortion,
        rotation=tuple(rotation.ravel().tolist()),
        translation=tuple((-rotation @ centre).tolist()),
        lens_residual=0.0,
        arena_residual=0.0,
        date=date or datetime.date(2000, 1, 1),
        made_with="rehearsal",
    )


def table_of_layout(table: Table, boxes: tuple[Box, ...]) -> Table:
    """Return the table with the boxes of a layout in place of its own: their sides and heights, tags from 10 on in their middle.

    Raises:
        UnusableTable: a tag does not fit on its box.
    """
    size = table.obstacles[0].size if table.obstacles else 0.06
    obstacles = tuple(
        ObstacleTag(id=FIRST_BOX_TAG + i, half_width=box.half_width, half_depth=box.half_depth, height=box.height, size=size)
        for i, box in enumerate(boxes)
    )
    found = msgspec.structs.replace(table, obstacles=obstacles)
    check_table(found)
    return found


class OverheadScene:
    """A table under its overhead camera.

    Args:
        table: what carries which tag. The n-th box of a layout carries the n-th obstacle's tag.
        calibration: the camera as it truly is.
        look: light and camera.
        strays: more tags lying on the floor, of the corner tags' size.
        covered: ids of tags that are papered over.
    """

    def __init__(
        self,
        table: Table,
        calibration: Calibration,
        look: OverheadLook | None = None,
        strays: tuple[CornerTag, ...] = (),
        covered: frozenset[int] = frozenset(),
    ) -> None:
        self.table, self.look = table, look or OverheadLook()
        self.camera = OverheadCamera(calibration)
        self._strays, self._covered = strays, covered
        self._floor = self._floor_of_pixel_corners()
        self._development = Development(calibration.width, calibration.height, self.look)
        self._colors = _colors()
        self._arena = np.array([table.width, table.depth, self.look.wall_height, 0.012])
        self._backgrounds: dict[tuple[Box, ...], _Background] = {}
        tags = [table.robots[robot] for robot in ROBOTS]
        self._robot_cells = np.stack([self._cells(tag.id) for tag in tags])
        self._bodies = np.array(
            [
                (
                    *(ROBOT_RADIUS, min(ROBOT_HEIGHT, tag.height), tag.forward, tag.left),
                    *(math.cos(tag.heading), math.sin(tag.heading), tag.size * _PLATE / 2, tag.height),
                )
                for tag in tags
            ]
        )

    def render(self, robots: Floats, boxes: tuple[Box, ...], seed: int, frame: int, speeds: Floats | None = None) -> Picture:
        """Take a picture.

        Args:
            robots: hider and seeker, float64 [2, 3] x, y (m), heading (rad) at the middle of the exposure; NaN: not there.
            boxes: obstacles, in the order of the table's.
            seed: of the noise.
            frame: number of the picture; its noise depends on (seed, frame) alone.
            speeds: of the robots, float64 [2, 3] m/s and rad/s; None: they stand.

        Returns:
            uint8 [H, W, 3] RGB, of its own memory.
        """
        background = self._background(boxes)
        light = background.light.copy()
        moments = self._moments(robots, speeds)
        for (left, top, right, bottom), members in self._patches(robots, speeds):
            margin = 2 * self.look.blur_reach
            outer = self._clipped(left - margin, top - margin, right + margin, bottom + margin)
            if outer[2] <= outer[0] or outer[3] <= outer[1]:
                continue
            patch = background.sharp[outer[1] : outer[3], outer[0] : outer[2]].copy()
            inner = self._clipped(left, top, right, bottom)
            if inner[2] > inner[0] and inner[3] > inner[1]:
                into = patch[inner[1] - outer[1] : inner[3] - outer[1], inner[0] - outer[0] : inner[2] - outer[0]]
                here = np.full_like(moments, np.nan)
                here[:, members] = moments[:, members]
                self._expose(inner, background, here, speeds is not None, into)
            self._development.develop(patch, outer, light)
        return self._development.read_out(light, seed, frame)

    def true_corners(self, robots: Floats, boxes: tuple[Box, ...]) -> dict[int, Floats]:
        """Return where every tag's corners truly are in a picture, by id: float64 [4, 2] px."""
        found = {}
        for tag in (*self.table.corners, *self._strays):
            corners = mounted_corners(self.table.corner_size, tag.x, tag.y, tag.heading)
            found[tag.id] = self._project(corners, 0.0)
        for box, obstacle in zip(boxes, self.table.obstacles, strict=False):
            corners = mounted_corners(obstacle.size, obstacle.along, obstacle.across, obstacle.heading)
            found[obstacle.id] = self._project(_moved(corners, box.x, box.y, box.heading), box.height)
        for robot, (x, y, heading) in zip(ROBOTS, robots.tolist(), strict=True):
            if not math.isnan(x):
                mount = self.table.robots[robot]
                corners = mounted_corners(mount.size, mount.forward, mount.left, mount.heading)
                found[mount.id] = self._project(_moved(corners, x, y, heading), mount.height)
        return found

    def _project(self, corners: Floats, height: float) -> Floats:
        return self.camera.project(np.column_stack((corners, np.full(len(corners), height))))

    def _cells(self, tag: int) -> Picture:
        cells = np.where(tag_cells(tag) > 0, LIGHT, DARK).astype(np.uint8)
        if tag in self._covered:
            cells[:] = COVER
        return cells

    def _floor_of_pixel_corners(self) -> Floats:
        width, height = self.camera.width, self.camera.height
        u, v = np.meshgrid(np.arange(width + 1) - 0.5, np.arange(height + 1) - 0.5)
        points, _ = self.camera.on_plane(np.stack((u, v), axis=-1).reshape(-1, 2), 0.0)
        return np.ascontiguousarray(points.reshape(height + 1, width + 1, 2))

    def _plates(self, boxes: tuple[Box, ...]) -> tuple[Floats, Picture]:
        rows, cells = [], []
        for tag in (*self.table.corners, *self._strays):
            half = self.table.corner_size * _PLATE / 2
            rows.append((tag.x, tag.y, math.cos(tag.heading), math.sin(tag.heading), half, 0.0))
            cells.append(self._cells(tag.id))
        for box, obstacle in zip(boxes, self.table.obstacles, strict=False):
            x, y = _moved(np.array([[obstacle.along, obstacle.across]]), box.x, box.y, box.heading)[0]
            angle = box.heading + obstacle.heading
            rows.append((x, y, math.cos(angle), math.sin(angle), obstacle.size * _PLATE / 2, box.height))
            cells.append(self._cells(obstacle.id))
        return np.array(rows), np.stack(cells)

    def _expose(
        self,
        window: tuple[int, int, int, int],
        background: _Background,
        moments: Floats,
        moving: bool,
        out: npt.NDArray[np.float32],
    ) -> None:
        near_boxes = _overlap(background.box_windows, window)
        near_plates = _overlap(background.plate_windows, window)
        expose_window(
            *window[:2],
            self._floor,
            self.camera.centre,
            self._arena,
            background.boxes[near_boxes],
            background.plates[near_plates],
            background.plate_cells[near_plates],
            moments,
            self._bodies,
            self._robot_cells,
            moving,
            self._colors,
            out,
        )

    def _background(self, boxes: tuple[Box, ...]) -> _Background:
        found = self._backgrounds.get(boxes)
        if found is None:
            height, width = self.camera.height, self.camera.width
            plates, cells = self._plates(boxes)
            corners = [_plate_corners(plate) for plate in plates]
            solids = [_box_corners(box) for box in boxes]
            found = _Background(
                sharp=np.empty((height, width, 3), np.float32),
                light=np.empty((height, width, 3), np.int16),
                boxes=boxes_array(boxes),
                box_windows=np.array([self._window_of(points) for points in solids]).reshape(-1, 4),
                plates=plates,
                plate_cells=cells,
                plate_windows=np.array([self._window_of(points) for points in corners]),
            )
            whole = (0, 0, width, height)
            self._expose(whole, found, np.full((MOMENTS, 2, 4), np.nan), False, found.sharp)
            self._development.develop(found.sharp, whole, found.light)
            while len(self._backgrounds) >= _KEPT_BACKGROUNDS:
                del self._backgrounds[next(iter(self._backgrounds))]
            self._backgrounds[boxes] = found
        return found

    def _window_of(self, points: Floats) -> Floats:
        """Left, top, right, bottom of points float64 [n, 3] in the picture, with a margin, float64 [4] px."""
        pixels = self.camera.project(points)
        return np.concatenate((pixels.min(axis=0) - 2, pixels.max(axis=0) + 2))

    def _moments(self, robots: Floats, speeds: Floats | None) -> Floats:
        """Robots at the moments of the exposure, float64 [5, 2, 4]."""
        times = (np.arange(MOMENTS) - (MOMENTS - 1) / 2) / MOMENTS * self.look.exposure
        moved = robots[None] + times[:, None, None] * (np.zeros((1, 2, 3)) if speeds is None else speeds[None])
        return np.concatenate((moved[..., :2], np.cos(moved[..., 2:]), np.sin(moved[..., 2:])), axis=-1)

    def _patches(self, robots: Floats, speeds: Floats | None) -> list[tuple[tuple[int, int, int, int], list[int]]]:
        """Windows and the robots in them; one for both where they touch."""
        windows: list[tuple[tuple[int, int, int, int], list[int]]] = []
        around = np.arange(16) * math.tau / 16
        for index in range(len(ROBOTS)):
            if math.isnan(robots[index, 0]):
                continue
            body = self._bodies[index]
            reach = 0.0 if speeds is None else float(np.hypot(speeds[index, 0], speeds[index, 1])) * self.look.exposure
            radius = max(body[0], math.hypot(body[2], body[3]) + body[6] * math.sqrt(2)) * 1.03 + reach
            ring = robots[index, :2] + radius * np.column_stack((np.cos(around), np.sin(around)))
            pixels = np.concatenate([self._project(ring, height) for height in (0.0, body[1], body[7])])
            low, high = np.floor(pixels.min(axis=0)).astype(int) - 1, np.ceil(pixels.max(axis=0)).astype(int) + 2
            windows.append(((int(low[0]), int(low[1]), int(high[0]), int(high[1])), [index]))
        if len(windows) == 2:
            (first, _), (second, _) = windows
            gap = 4 * self.look.blur_reach
            apart = any(one[i + 2] + gap < other[i] for one, other in ((first, second), (second, first)) for i in range(2))
            if not apart:
                low = (min(first[0], second[0]), min(first[1], second[1]))
                return [((*low, max(first[2], second[2]), max(first[3], second[3])), [0, 1])]
        return windows

    def _clipped(self, left: int, top: int, right: int, bottom: int) -> tuple[int, int, int, int]:
        return max(left, 0), max(top, 0), min(right, self.camera.width), min(bottom, self.camera.height)


def _overlap(windows: Floats, window: tuple[int, int, int, int]) -> npt.NDArray[np.bool_]:
    """Which of windows float64 [n, 4] touch a window."""
    left, top, right, bottom = window
    return (windows[:, 0] < right) & (windows[:, 2] > left) & (windows[:, 1] < bottom) & (windows[:, 3] > top)


def _plate_corners(plate: Floats) -> Floats:
    x, y, cosine, sine, half, height = plate
    corners = mounted_corners(2 * half, x, y, math.atan2(sine, cosine))
    return np.column_stack((corners, np.full(4, height)))


def _box_corners(box: Box) -> Floats:
    local = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array([box.half_width, box.half_depth])
    corners = _moved(local, box.x, box.y, box.heading)
    return np.concatenate([np.column_stack((corners, np.full(4, height))) for height in (0.0, box.height)])


def _moved(points: Floats, x: float, y: float, heading: float) -> Floats:
    """Points float64 [n, 2] on the axes of a body at x, y, heading -> the arena's."""
    cosine, sine = math.cos(heading), math.sin(heading)
    return points @ np.array([[cosine, sine], [-sine, cosine]]) + np.array([x, y])


def _colors() -> npt.NDArray[np.float32]:
    """Colours by number, float32 [13, 3] RGB."""

    def shaded(color: tuple[int, int, int], factor: float) -> tuple[float, ...]:
        return tuple(factor * channel for channel in color)

    rows = (
        *(shaded(BACKGROUND_COLOR, 2.0), FLOOR_COLOR, shaded(WALL_COLOR, 0.8), WALL_COLOR),
        *(shaded(BOX_COLOR, 0.8), shaded(BOX_COLOR, 1.1), (22, 22, 24), (236, 236, 232), (130, 128, 126)),
        *(shaded(HIDER_COLOR, 0.6), shaded(SEEKER_COLOR, 0.6), HIDER_COLOR, SEEKER_COLOR),
    )
    return np.array(rows, dtype=np.float32)
