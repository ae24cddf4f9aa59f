"""The state image I: the top-down visibility map of one view (paper, State Representation; reading, rows 7 and 8)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas import STATE_IMAGE_SIZE, ColorImage, DepthImage, Pose, Robot
from vantage.compiled import kernel
from vantage.perception.palette import BOUNDARY, FREE, INVISIBLE, OTHER, OWN, PIXEL_SIZE
from vantage.perception.scan import NOTHING, ROBOT, SURFACE, find_other, scan_columns
from vantage.world.arena import ARENA_SIZE, ROBOT_RADIUS

BRIDGED_COLUMNS = 2
"""Widest hole of drop-outs that is drawn over."""
SEEN_COLUMNS = 2
"""Columns of the other robot's colour from which on it counts as seen."""

_SIZE = STATE_IMAGE_SIZE
_RADIUS = ROBOT_RADIUS / PIXEL_SIZE


def _suffix_masks() -> NDArray[np.uint64]:
    """[129, 2]: the bits of columns c .. 127, as two words of 64 columns."""
    everything = (1 << _SIZE) - 1
    rows = [(everything << c) & everything for c in range(_SIZE + 1)]
    return np.array([(row & (2**64 - 1), row >> 64) for row in rows], dtype=np.uint64)


def _eight_pixels() -> NDArray[np.uint64]:
    """[256]: the eight pixels, FREE or INVISIBLE, that eight bits stand for, first column at the lowest address."""
    bits = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1, bitorder="little")
    pixels = np.where(bits == 1, FREE, INVISIBLE).astype(np.uint8)
    return np.ascontiguousarray(pixels).view(np.uint64).ravel()


_FROM_COLUMN = _suffix_masks()
_PIXELS = _eight_pixels()


@kernel
def _toggle_edge(rows: NDArray[np.uint64], x0: float, y0: float, x1: float, y1: float) -> None:
    """In each row whose centre line the edge crosses, flips all pixels whose centre is right of the crossing.

    Done for every edge of a closed polygon this leaves the bits of its inside set (even-odd rule). Pixel coordinates.
    """
    if y0 > y1:
        x0, y0, x1, y1 = x1, y1, x0, y0
    first = max(0, math.ceil(y0 - 0.5))
    stop = min(_SIZE, math.ceil(y1 - 0.5))
    if first >= stop:
        return
    slope = (x1 - x0) / (y1 - y0)
    crossing = x0 + (first + 0.5 - y0) * slope - 0.5
    for row in range(first, stop):
        column = int(math.ceil(min(float(_SIZE), max(0.0, crossing))))
        rows[row, 0] ^= _FROM_COLUMN[column, 0]
        rows[row, 1] ^= _FROM_COLUMN[column, 1]
        crossing += slope


@kernel
def _disc(image: NDArray[np.uint8], x: float, y: float, value: int) -> None:
    """Paints the pixels whose centre lies within a robot's radius of (x, y), pixel coordinates."""
    if not (-2.0 * _RADIUS < x < _SIZE + 2.0 * _RADIUS and -2.0 * _RADIUS < y < _SIZE + 2.0 * _RADIUS):
        return
    for row in range(max(0, math.ceil(y - _RADIUS - 0.5)), min(_SIZE, math.floor(y + _RADIUS - 0.5) + 1)):
        offset = row + 0.5 - y
        half = math.sqrt(max(0.0, _RADIUS * _RADIUS - offset * offset))
        for column in range(max(0, math.ceil(x - half - 0.5)), min(_SIZE, math.floor(x + half - 0.5) + 1)):
            image[row, column] = value


@kernel
def _plot(image: NDArray[np.uint8], x: float, y: float) -> None:
    if 0.0 <= x <= _SIZE and 0.0 <= y <= _SIZE:
        image[min(_SIZE - 1, int(y)), min(_SIZE - 1, int(x))] = BOUNDARY


@kernel
def _cut(x: float, y: float, dx: float, dy: float) -> tuple[float, float]:
    """End of the ray from (x, y) by (dx, dy), cut where it leaves the picture; pixel coordinates, (x, y) inside."""
    part = 1.0
    if x + dx > _SIZE:
        part = min(part, (_SIZE - x) / dx)
    elif x + dx < 0.0:
        part = min(part, -x / dx)
    if y + dy > _SIZE:
        part = min(part, (_SIZE - y) / dy)
    elif y + dy < 0.0:
        part = min(part, -y / dy)
    return x + part * dx, y + part * dy


@kernel
def _joined(inverse: NDArray[np.float64], u: int) -> bool:
    """Whether columns u - 1 and u show one surface: near each other, or in line, for 1 / range is linear along a plane."""
    before = inverse[u - 1]
    after = inverse[u]
    step = after - before
    if abs(step) <= 0.04 * before * after + 0.03 * max(before, after):
        return True
    tolerance = 0.25 * abs(step)
    if u >= 2 and abs(before - inverse[u - 2] - step) <= tolerance:
        return True
    return u + 1 < inverse.shape[0] and abs(inverse[u + 1] - after - step) <= tolerance


@kernel
def draw(
    ranges: NDArray[np.float64],  # [W]
    kinds: NDArray[np.uint8],  # [W]
    fx: float,
    cx: float,
    x: float,
    y: float,
    heading: float,
    other_seen: bool,
    other_x: float,
    other_y: float,
    image_out: NDArray[np.uint8],  # [128, 128], C order
) -> None:
    """Draws the state image of one view, palette indices; row 0 is the far side of the arena.

    `ranges`, `kinds`, `fx` (px), `cx` (px) as of `scan_columns`; pose (m, m, rad) and the other's centre (m) in the arena
    frame, the latter used where `other_seen`. Free is what lies between the robot and the columns' ends; a column without
    return is unknown, thus invisible, except that a hole of at most `BRIDGED_COLUMNS` columns is drawn over: between
    columns of like kind and range with what lies between them, otherwise free up to the nearer of the two. Boundary is
    where a column ends on anything but the other robot. Ends beyond the arena are cut at its edge.
    """
    width = ranges.shape[0]
    center_x = x / PIXEL_SIZE
    center_y = (ARENA_SIZE - y) / PIXEL_SIZE
    inside = 0.0 <= center_x <= _SIZE and 0.0 <= center_y <= _SIZE
    ahead_x = math.cos(heading) / PIXEL_SIZE
    ahead_y = -math.sin(heading) / PIXEL_SIZE
    right_x = -ahead_y / fx
    right_y = ahead_x / fx

    inverse = np.empty(width)  # 1 / range; 0 = nothing
    surface = np.empty(width, np.uint8)
    last = -1
    for u in range(width):
        kind = kinds[u]
        surface[u] = kind
        if kind == NOTHING:
            inverse[u] = 0.0
            continue
        inverse[u] = 1.0 / max(ranges[u], 1e-3)
        hole = u - last - 1
        if 0 < hole <= BRIDGED_COLUMNS and last >= 0:
            before = inverse[last]
            after = inverse[u]
            like = surface[last] == kind and abs(after - before) <= 0.06 * before * after + 0.03 * max(before, after)
            for k in range(last + 1, u):
                surface[k] = kind if like else ROBOT
                inverse[k] = before + (after - before) * (k - last) / (hole + 1) if like else max(before, after)
        last = u

    rows = np.zeros((_SIZE, 2), np.uint64)
    ends = np.empty((width, 2))
    joined = np.zeros(width, np.bool_)
    pen_x = center_x
    pen_y = center_y
    away = False
    for u in range(width + 1):
        shown = u < width and inverse[u] > 0.0
        join = shown and away and _joined(inverse, u)
        if not join:
            # The borders between columns: out along the last one's end, and on at this one's.
            sideways = u - 0.5 - cx
            direction_x = ahead_x + sideways * right_x
            direction_y = ahead_y + sideways * right_y
            for border in range(u - 1, u + 1):
                if (border == u and shown) or (border < u and away):
                    reach = 1.0 / inverse[border]
                    next_x = center_x + reach * direction_x
                    next_y = center_y + reach * direction_y
                    if inside:
                        next_x, next_y = _cut(center_x, center_y, reach * direction_x, reach * direction_y)
                    _toggle_edge(rows, pen_x, pen_y, next_x, next_y)
                    pen_x = next_x
                    pen_y = next_y
            if away and not shown:
                _toggle_edge(rows, pen_x, pen_y, center_x, center_y)
                pen_x = center_x
                pen_y = center_y
        if shown:
            reach = 1.0 / inverse[u]
            offset_x = reach * (ahead_x + (u - cx) * right_x)
            offset_y = reach * (ahead_y + (u - cx) * right_y)
            next_x = center_x + offset_x
            next_y = center_y + offset_y
            if inside and not (0.0 <= next_x <= _SIZE and 0.0 <= next_y <= _SIZE):
                next_x, next_y = _cut(center_x, center_y, offset_x, offset_y)
            _toggle_edge(rows, pen_x, pen_y, next_x, next_y)
            pen_x = next_x
            pen_y = next_y
            ends[u, 0] = next_x
            ends[u, 1] = next_y
            joined[u] = join and surface[u] == surface[u - 1]
        away = shown

    words = image_out.view(np.uint64)  # [128, 16]
    for row in range(_SIZE):
        for half in range(2):
            bits = rows[row, half]
            for k in range(8):
                words[row, 8 * half + k] = _PIXELS[(bits >> np.uint64(8 * k)) & np.uint64(255)]

    for u in range(width):
        if surface[u] != SURFACE:
            continue
        end_x = ends[u, 0]
        end_y = ends[u, 1]
        if joined[u]:
            step_x = end_x - ends[u - 1, 0]
            step_y = end_y - ends[u - 1, 1]
            pieces = int(max(abs(step_x), abs(step_y))) + 1
            for k in range(1, pieces):
                _plot(image_out, end_x - step_x * k / pieces, end_y - step_y * k / pieces)
        _plot(image_out, end_x, end_y)

    if other_seen:
        _disc(image_out, other_x / PIXEL_SIZE, (ARENA_SIZE - other_y) / PIXEL_SIZE, OTHER)
    _disc(image_out, center_x, center_y, OWN)


@kernel
def look(
    depth: NDArray[np.uint16],  # [H, W]
    color: NDArray[np.uint8],  # [H, W, 3]
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    mount_height: float,
    other_color: int,
    x: float,
    y: float,
    heading: float,
    ranges_out: NDArray[np.float64],  # [W]
    kinds_out: NDArray[np.uint8],  # [W]
    draws: bool,
    image_out: NDArray[np.uint8],  # [128, 128]
) -> tuple[int, bool, float, float]:
    """`scan_columns`, `find_other` and, where `draws`, `draw`: all that is perceived in one view, in one call."""
    scan_columns(depth, color, fx, fy, cx, cy, mount_height, other_color, ranges_out, kinds_out)
    seen, whole, other_x, other_y = find_other(ranges_out, kinds_out, fx, cx, x, y, heading)
    if draws:
        draw(ranges_out, kinds_out, fx, cx, x, y, heading, seen >= SEEN_COLUMNS, other_x, other_y, image_out)
    return seen, whole, other_x, other_y


@dataclass(slots=True)
class Perceived:
    """What one robot perceives in one view."""

    image: NDArray[np.uint8]
    """State image, palette indices [128, 128]; [0, 0] where it was not drawn."""
    ranges: NDArray[np.float64]
    """Distance along the optical axis to the nearest surface of each column, m; NaN = none. [W]"""
    kinds: NDArray[np.uint8]
    """What each column shows: 0 nothing, 1 a surface, 2 the other robot. [W]"""
    other: tuple[float, float] | None
    """The other robot's centre, arena frame, m; None where fewer than `SEEN_COLUMNS` columns show it."""
    seen_columns: int
    """Columns that show the other robot."""
    whole: bool
    """Whether all of the other robot is in view."""


_UNDRAWN: NDArray[np.uint8] = np.empty((0, 0), np.uint8)


def perceive(depth: DepthImage, color: ColorImage, pose: Pose, robot: Robot, draw: bool = True) -> Perceived:
    """What `robot` perceives in one view: the one path from camera messages to the state image and the sighting.

    `draw=False` leaves the state image out. Raises ValueError where depth and colour differ in size.
    """
    height, width = depth.height, depth.width
    if color.height != height or color.width != width:
        raise ValueError(
            f"colour ({color.width} x {color.height}) must be registered to depth ({width} x {height}): align them in the camera driver"
        )
    camera = depth.intrinsics
    ranges = np.empty(width)
    kinds = np.empty(width, np.uint8)
    image = np.empty((_SIZE, _SIZE), np.uint8) if draw else _UNDRAWN
    seen, whole, other_x, other_y = look(
        np.frombuffer(depth.data, np.uint16).reshape(height, width),
        np.frombuffer(color.data, np.uint8).reshape(height, width, 3),
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        camera.mount_height,
        1 if robot == "hider" else 0,
        pose.x,
        pose.y,
        pose.heading,
        ranges,
        kinds,
        draw,
        image,
    )
    return Perceived(image, ranges, kinds, (other_x, other_y) if seen >= SEEN_COLUMNS else None, seen, whole)
