"""What the rays of an overhead camera hit on a table: floor, walls, boxes, robots (upright cylinders) and tags, exactly.

A ray is given by its point on the floor, p: at height h it stands over p + (camera - p) h / camera height, so the first hit is
the highest. Pixels whose corners all hit the same colour are of that colour; all others are sampled 5 x 5 times, each sample at
one of five moments of the exposure (a Latin square over the pixel), which gives edges and motion blur at once.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from vantage.compiled import kernel

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Bytes = npt.NDArray[np.uint8]

MOMENTS = 5
"""Moments of the exposure, and samples of a mixed pixel each way."""

OUTSIDE, FLOOR, WALL, WALL_TOP, BOX_SIDE, BOX_TOP, DARK, LIGHT, COVER, HIDER_SIDE, SEEKER_SIDE, HIDER_TOP, SEEKER_TOP = range(13)
"""Colours by number. Dark and light are a tag's."""


@kernel
def _plate_color(u: float, v: float, half: float, cells: Bytes) -> int:
    """Colour of a tag at u, v from its centre on its own axes, -1 beside it; half its side with border; cells uint8 [10, 10]."""
    if not (abs(u) < half and abs(v) < half):
        return -1
    count = cells.shape[0]
    column = min(int((u + half) / (2.0 * half) * count), count - 1)
    row = min(int((half - v) / (2.0 * half) * count), count - 1)
    return int(np.int64(cells[row, column]))


@kernel
def _box_entry(x: float, y: float, dx: float, dy: float, box: Floats, camera_height: float) -> tuple[float, bool]:
    """Height at which a ray enters a box (float64 [7] as in `world`), and whether by its top; -1 where it passes."""
    cosine, sine = box[4], box[5]
    relative_x, relative_y = x - box[0], y - box[1]
    u, v = cosine * relative_x + sine * relative_y, cosine * relative_y - sine * relative_x
    du, dv = cosine * dx + sine * dy, cosine * dy - sine * dx
    top = box[6] / camera_height
    if abs(u + du * top) < box[2] and abs(v + dv * top) < box[3]:
        return box[6], True
    low, high = 0.0, top
    for axis in range(2):
        start, along, half = (u, du, box[2]) if axis == 0 else (v, dv, box[3])
        if along == 0.0:
            if abs(start) > half:
                return -1.0, False
            continue
        first, second = (-half - start) / along, (half - start) / along
        low, high = max(low, min(first, second)), min(high, max(first, second))
    return (high * camera_height, False) if low <= high else (-1.0, False)


@kernel
def _cylinder_entry(
    x: float, y: float, dx: float, dy: float, centre_x: float, centre_y: float, radius: float, height: float, camera_height: float
) -> tuple[float, bool]:
    """Height at which a ray enters an upright cylinder, and whether by its top; -1 where it passes."""
    u, v = x - centre_x, y - centre_y
    top = height / camera_height
    at_u, at_v = u + dx * top, v + dy * top
    if at_u * at_u + at_v * at_v < radius * radius:
        return height, True
    a, b, c = dx * dx + dy * dy, u * dx + v * dy, u * u + v * v - radius * radius
    under = b * b - a * c
    if under < 0.0 or a == 0.0:
        return -1.0, False
    high = (math.sqrt(under) - b) / a
    if high < 0.0 or high > top:
        return -1.0, False
    return high * camera_height, False


@kernel
def color_at(
    x: float,
    y: float,
    camera: Floats,
    arena: Floats,
    boxes: Floats,
    plates: Floats,
    plate_cells: Bytes,
    robots: Floats,
    bodies: Floats,
    robot_cells: Bytes,
) -> int:
    """Return the colour that the ray through the floor at x, y hits first.

    camera float64 [3] centre; arena float64 [4] width, depth, wall height, wall thickness; boxes float64 [n, 7]; plates float64
    [p, 6] (x, y, cos, sin, half side, height) with plate_cells uint8 [p, 10, 10]; robots float64 [2, 4] (x, y, cos, sin; NaN:
    none); bodies float64 [2, 8] (radius, height, tag forward, left, cos, sin, half side, height), robot_cells uint8 [2, 10, 10].
    """
    dx, dy = camera[0] - x, camera[1] - y
    best, color = 0.0, FLOOR if 0.0 <= x <= arena[0] and 0.0 <= y <= arena[1] else OUTSIDE
    wall = arena[2] / camera[2]
    if wall > 0.0:
        top_x, top_y = x + dx * wall, y + dy * wall
        if not (0.0 <= top_x <= arena[0] and 0.0 <= top_y <= arena[1]):
            if -arena[3] <= top_x <= arena[0] + arena[3] and -arena[3] <= top_y <= arena[1] + arena[3]:
                best, color = arena[2], WALL_TOP
        elif color == OUTSIDE:
            # Coming down inside the arena, the ray meets the wall that it crosses highest.
            share = max(-x / dx if x < 0.0 else 0.0, -y / dy if y < 0.0 else 0.0)
            share = max(share, (arena[0] - x) / dx if x > arena[0] else 0.0, (arena[1] - y) / dy if y > arena[1] else 0.0)
            best, color = share * camera[2], WALL
    for index in range(plates.shape[0]):
        plate = plates[index]
        if plate[5] < best:
            continue
        share = plate[5] / camera[2]
        u, v = x + dx * share - plate[0], y + dy * share - plate[1]
        cell = _plate_color(plate[2] * u + plate[3] * v, plate[2] * v - plate[3] * u, plate[4], plate_cells[index])
        if cell >= 0:
            best, color = plate[5], cell
    for index in range(boxes.shape[0]):
        entry, by_top = _box_entry(x, y, dx, dy, boxes[index], camera[2])
        # A tag lies on its box: it stays in sight at the same height.
        if entry > best:
            best, color = entry, BOX_TOP if by_top else BOX_SIDE
    for index in range(robots.shape[0]):
        if math.isnan(robots[index, 0]):
            continue
        body, robot = bodies[index], robots[index]
        share = body[7] / camera[2]
        u, v = x + dx * share - robot[0], y + dy * share - robot[1]
        ahead, left = robot[2] * u + robot[3] * v - body[2], robot[2] * v - robot[3] * u - body[3]
        cell = _plate_color(body[4] * ahead + body[5] * left, body[4] * left - body[5] * ahead, body[6], robot_cells[index])
        if cell >= 0 and body[7] >= best:
            best, color = body[7], cell
            continue
        entry, by_top = _cylinder_entry(x, y, dx, dy, robot[0], robot[1], body[0], body[1], camera[2])
        if entry > best:
            best, color = entry, (HIDER_TOP if by_top else HIDER_SIDE) + index
    return color


@kernel
def expose_window(
    left: int,
    top: int,
    floor: Floats,
    camera: Floats,
    arena: Floats,
    boxes: Floats,
    plates: Floats,
    plate_cells: Bytes,
    robots: Floats,
    bodies: Floats,
    robot_cells: Bytes,
    moving: bool,
    colors: npt.NDArray[np.float32],
    out: npt.NDArray[np.float32],
) -> None:
    """Render a window of the picture, not yet blurred by the lens, into out float32 [h, w, 3].

    floor float64 [H + 1, W + 1, 2]: where the rays through the pixels' corners meet the floor; robots float64 [5, 2, 4]: at the
    moments of the exposure; colors float32 [13, 3].
    """
    height, width = out.shape[0], out.shape[1]
    rows = np.empty((2, width + 1), np.int64)
    last = np.empty((2, width + 1), np.int64)
    for v in range(height + 1):
        now = v & 1
        for u in range(width + 1):
            x, y = floor[top + v, left + u, 0], floor[top + v, left + u, 1]
            rows[now, u] = color_at(x, y, camera, arena, boxes, plates, plate_cells, robots[0], bodies, robot_cells)
            if moving:
                last[now, u] = color_at(x, y, camera, arena, boxes, plates, plate_cells, robots[MOMENTS - 1], bodies, robot_cells)
            else:
                last[now, u] = rows[now, u]
        if v == 0:
            continue
        for u in range(width):
            color = rows[0, u]
            same = color == rows[0, u + 1] and color == rows[1, u] and color == rows[1, u + 1]
            same = same and color == last[0, u] and color == last[0, u + 1] and color == last[1, u] and color == last[1, u + 1]
            if same:
                for channel in range(3):
                    out[v - 1, u, channel] = colors[color, channel]
                continue
            red, green, blue = 0.0, 0.0, 0.0
            corner = floor[top + v - 1 : top + v + 1, left + u : left + u + 2]
            for i in range(MOMENTS):
                down = (i + 0.5) / MOMENTS
                for j in range(MOMENTS):
                    right = (j + 0.5) / MOMENTS
                    weights = ((1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right)
                    x = weights[0] * corner[0, 0, 0] + weights[1] * corner[0, 1, 0]
                    x += weights[2] * corner[1, 0, 0] + weights[3] * corner[1, 1, 0]
                    y = weights[0] * corner[0, 0, 1] + weights[1] * corner[0, 1, 1]
                    y += weights[2] * corner[1, 0, 1] + weights[3] * corner[1, 1, 1]
                    moment = robots[(i + 2 * j) % MOMENTS]
                    color = color_at(x, y, camera, arena, boxes, plates, plate_cells, moment, bodies, robot_cells)
                    red += colors[color, 0]
                    green += colors[color, 1]
                    blue += colors[color, 2]
            out[v - 1, u, 0] = red / MOMENTS**2
            out[v - 1, u, 1] = green / MOMENTS**2
            out[v - 1, u, 2] = blue / MOMENTS**2
