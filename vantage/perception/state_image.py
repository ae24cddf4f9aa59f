"""The state image I: the top-down visibility map of one view (paper, State Representation; reading, rows 7 and 8)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas import STATE_IMAGE_SIZE, ColorImage, DepthImage, Intrinsics, Pose, Robot
from vantage.compiled import kernel
from vantage.perception.palette import BOUNDARY, FREE, INVISIBLE, OTHER, OWN, PIXEL_SIZE
from vantage.perception.scan import NOTHING, SURFACE, find_other, scan_columns
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
        column = math.ceil(min(float(_SIZE), max(0.0, crossing)))
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
def _end(x: float, y: float, reach: float, direction_x: float, direction_y: float, inside: bool) -> tuple[float, float]:
    """End of the ray from (x, y), pixel coordinates, cut where it leaves the picture if (x, y) is `inside`."""
    dx = reach * direction_x
    dy = reach * direction_y
    if inside and not (0.0 <= x + dx <= _SIZE and 0.0 <= y + dy <= _SIZE):
        part = 1.0
        if x + dx > _SIZE:
            part = min(part, (_SIZE - x) / dx)
        elif x + dx < 0.0:
            part = min(part, -x / dx)
        if y + dy > _SIZE:
            part = min(part, (_SIZE - y) / dy)
        elif y + dy < 0.0:
            part = min(part, -y / dy)
        # Held at the edge, from which rounding might take it.
        return min(float(_SIZE), max(0.0, x + part * dx)), min(float(_SIZE), max(0.0, y + part * dy))
    return x + dx, y + dy


@kernel
def _joined(ranges: NDArray[np.float64], kinds: NDArray[np.uint8], last: int, u: int) -> bool:
    """Whether columns `last` and `u`, the next with a return, show one surface.

    They do where their ranges are close, or where they lie in line with a neighbour: 1 / range is linear along a plane.
    """
    before = ranges[last]
    after = ranges[u]
    if abs(after - before) <= 0.04 + 0.03 * min(before, after):
        return True
    step = (1.0 / after - 1.0 / before) / (u - last)
    tolerance = 0.25 * abs(step)
    if last > 0 and kinds[last - 1] != NOTHING and abs(1.0 / before - 1.0 / ranges[last - 1] - step) <= tolerance:
        return True
    return u + 1 < ranges.shape[0] and kinds[u + 1] != NOTHING and abs(1.0 / ranges[u + 1] - 1.0 / after - step) <= tolerance


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
    frame, the latter used where `other_seen`. Free is what lies between the robot and the columns' ends. A column without
    return is unknown, thus invisible; but a hole of at most `BRIDGED_COLUMNS` columns is drawn over, straight where both
    sides show one surface, otherwise each half like its side. Boundary is where a column ends on anything but the other
    robot, and along the line between columns that show one surface. Ends beyond the arena are cut at its edge.
    """
    width = ranges.shape[0]
    center_x = x / PIXEL_SIZE
    center_y = (ARENA_SIZE - y) / PIXEL_SIZE
    inside = 0.0 <= center_x <= _SIZE and 0.0 <= center_y <= _SIZE
    ahead_x = math.cos(heading) / PIXEL_SIZE
    ahead_y = -math.sin(heading) / PIXEL_SIZE
    right_x = -ahead_y / fx
    right_y = ahead_x / fx

    rows = np.zeros((_SIZE, 2), np.uint64)
    ends = np.empty((width, 2))
    line_from = np.full(width, -1)  # the column from which the boundary runs on to this one
    pen_x = center_x
    pen_y = center_y
    last = -1
    for u in range(width + 1):
        if u < width and kinds[u] == NOTHING:
            continue
        bridged = last >= 0 and u < width and u - last <= BRIDGED_COLUMNS + 1
        if bridged and _joined(ranges, kinds, last, u):
            if kinds[u] == kinds[last]:
                line_from[u] = last
        else:
            # Borders between columns: out along the last one's end, (to the robot,) and on along this one's.
            if last >= 0:
                sideways = (0.5 * (last + u) if bridged else last + 0.5) - cx
                next_x, next_y = _end(
                    center_x, center_y, ranges[last], ahead_x + sideways * right_x, ahead_y + sideways * right_y, inside
                )
                _toggle_edge(rows, pen_x, pen_y, next_x, next_y)
                pen_x, pen_y = next_x, next_y
                if not bridged:
                    _toggle_edge(rows, pen_x, pen_y, center_x, center_y)
                    pen_x, pen_y = center_x, center_y
            if u == width:
                break
            sideways = (0.5 * (last + u) if bridged else u - 0.5) - cx
            next_x, next_y = _end(
                center_x, center_y, ranges[u], ahead_x + sideways * right_x, ahead_y + sideways * right_y, inside
            )
            _toggle_edge(rows, pen_x, pen_y, next_x, next_y)
            pen_x, pen_y = next_x, next_y
        sideways = u - cx
        next_x, next_y = _end(center_x, center_y, ranges[u], ahead_x + sideways * right_x, ahead_y + sideways * right_y, inside)
        _toggle_edge(rows, pen_x, pen_y, next_x, next_y)
        pen_x, pen_y = next_x, next_y
        ends[u, 0] = next_x
        ends[u, 1] = next_y
        last = u

    words = image_out.view(np.uint64)  # [128, 16]
    for row in range(_SIZE):
        for half in range(2):
            bits = rows[row, half]
            for k in range(8):
                words[row, 8 * half + k] = _PIXELS[(bits >> np.uint64(8 * k)) & np.uint64(255)]

    for u in range(width):
        if kinds[u] != SURFACE:
            continue
        end_x = ends[u, 0]
        end_y = ends[u, 1]
        if line_from[u] >= 0:
            step_x = end_x - ends[line_from[u], 0]
            step_y = end_y - ends[line_from[u], 1]
            # Longer than the picture only where the robot stands outside it: an absurd pose must not take for ever.
            pieces = int(min(max(abs(step_x), abs(step_y)), 4.0 * _SIZE)) + 1
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
    camera: Intrinsics
    """The camera that saw it."""


_UNDRAWN: NDArray[np.uint8] = np.empty((0, 0), np.uint8)


def perceive(depth: DepthImage, color: ColorImage, pose: Pose, robot: Robot, draw: bool = True) -> Perceived:
    """What `robot` perceives in one view: the one path from camera messages to the state image and the sighting.

    `draw=False` leaves the state image out. Raises ValueError where depth and colour differ in size.
    """
    height, width = depth.height, depth.width
    if color.height != height or color.width != width:
        raise ValueError(
            f"colour ({color.width} x {color.height}) must be registered to depth ({width} x {height}): "
            "align them in the camera driver"
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
    return Perceived(image, ranges, kinds, (other_x, other_y) if seen >= SEEN_COLUMNS else None, seen, whole, camera)
