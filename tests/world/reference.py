"""Slow references for the world's kernels, written another way: three-dimensional rays against faces, sampled outlines."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from vantage.world import arena
from vantage.world.camera import Camera, directions
from vantage.world.layout import boxes_array, make_layout
from vantage.world.rays import BOX_TOP, BOX_X, FLOOR, NOTHING, ROBOT_HIDER, WALL_X
from vantage.world.start import Placed, draw_start

Floats = npt.NDArray[np.float64]


def scene(seed: int, minimum: float = 0.25, maximum: float = 0.9) -> tuple[Floats, Placed, Placed]:
    """Boxes of a random layout, and two placed robots."""
    boxes = boxes_array(make_layout("random", seed))
    return (boxes, *draw_start(boxes, arena.ARENA_SIZE, arena.ARENA_SIZE, seed, minimum, maximum))


def corners(box: Floats) -> Floats:
    """Corners in order around one row of the boxes array: float64 [4, 2]."""
    x, y, half_width, half_depth, cosine, sine, _ = box
    local = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (half_width, half_depth)
    return local @ np.array([(cosine, sine), (-sine, cosine)]) + (x, y)


def outline(box: Floats, count: int = 200) -> Floats:
    """Points on a box's edges: float64 [4 count, 2]."""
    points = corners(box)
    part = np.arange(count)[:, None] / count
    return np.concatenate([points[i] + part * (points[(i + 1) % 4] - points[i]) for i in range(4)])


def inside(box: Floats, points: Floats) -> npt.NDArray[np.bool_]:
    """Are points [..., 2] strictly inside a box? By the side of each edge they lie on."""
    around = corners(box)
    result = np.ones(points.shape[:-1], np.bool_)
    for i in range(4):
        edge = around[(i + 1) % 4] - around[i]
        offset = points - around[i]
        result &= edge[0] * offset[..., 1] - edge[1] * offset[..., 0] > 0.0
    return result


def turned(boxes: Floats, quarters: int) -> Floats:
    """The boxes after quarter turns of the whole arena about its centre."""
    result = boxes.copy()
    for _ in range(quarters):
        result[:, 0], result[:, 1] = arena.ARENA_SIZE - result[:, 1].copy(), result[:, 0].copy()
        result[:, 4], result[:, 5] = -result[:, 5].copy(), result[:, 4].copy()
    return result


def turned_place(x: float, y: float, heading: int, quarters: int) -> Placed:
    """A pose after quarter turns of the whole arena about its centre."""
    for _ in range(quarters):
        x, y, heading = arena.ARENA_SIZE - y, x, (heading + 9) % 36
    return x, y, heading


def _on_face(origin: Floats, rays: Floats, point: Floats, along: Floats, height: float) -> Floats:
    """Ray parameter where rays [..., 3] meet an upright face from `point` along `along` (both [2]), inf where they miss."""
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = rays[..., 0] * -along[1] + rays[..., 1] * along[0]
        offset = point - origin[:2]
        distance = (offset[0] * -along[1] + offset[1] * along[0]) / determinant
        part = (rays[..., 0] * offset[1] - rays[..., 1] * offset[0]) / determinant
        z = origin[2] + distance * rays[..., 2]
    hit = (distance > 0.0) & (part >= 0.0) & (part <= 1.0) & (z >= 0.0) & (z <= height)
    return np.where(hit, distance, np.inf)


def _upright(origin: Floats, rays: Floats, around: Floats, height: float, kind: int) -> list[tuple[Floats, int]]:
    """The four faces over the corners `around` [4, 2]: what rays meet of each, and its kind."""
    return [(_on_face(origin, rays, around[i], around[(i + 1) % 4] - around[i], height), kind) for i in range(4)]


def view(
    camera: Camera, boxes: Floats, x: float, y: float, heading: float, other: tuple[float, float] | None, other_color: int
) -> tuple[Floats, npt.NDArray[np.int64]]:
    """What each pixel of a camera sees: depth along the axis in m (0 none), and the kind of surface (no shades, no indices)."""
    rightward, downward = directions(camera)
    forward = np.array([math.cos(heading), math.sin(heading), 0.0])
    right = np.array([math.sin(heading), -math.cos(heading), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    # The parameter of these rays is the depth along the axis, for their component along it is 1.
    rays = forward + rightward[None, :, None] * right + downward[:, None, None] * down
    origin = np.array([x, y, camera.mount_height])
    size = arena.ARENA_SIZE
    room = np.array([(0.0, 0.0), (size, 0.0), (size, size), (0.0, size)])
    candidates = _upright(origin, rays, room, arena.WALL_HEIGHT, WALL_X)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_floor = -origin[2] / rays[..., 2]
        landing = origin[:2] + to_floor[..., None] * rays[..., :2]
        on_floor = (to_floor > 0.0) & (landing >= 0.0).all(axis=-1) & (landing <= size).all(axis=-1)
    candidates.append((np.where(on_floor, to_floor, np.inf), FLOOR))

    for box in boxes:
        candidates.extend(_upright(origin, rays, corners(box), box[6], BOX_X))
        with np.errstate(divide="ignore", invalid="ignore"):
            to_top = (box[6] - origin[2]) / rays[..., 2]
            landing = origin[:2] + to_top[..., None] * rays[..., :2]
            on_top = (to_top > 0.0) & np.isfinite(to_top) & inside(box, np.nan_to_num(landing, posinf=9.0, neginf=9.0))
        candidates.append((np.where(on_top, to_top, np.inf), BOX_TOP))

    if other is not None:
        candidates.extend((hit, ROBOT_HIDER + other_color) for hit in _on_robot(origin, rays, np.array(other)))

    depths = np.stack([depth for depth, _ in candidates])
    kinds = np.array([kind for _, kind in candidates])
    first = depths.argmin(axis=0)
    nearest = np.take_along_axis(depths, first[None], axis=0)[0]
    hit = np.isfinite(nearest)
    return np.where(hit, nearest, 0.0), np.where(hit, kinds[first], NOTHING)


def _on_robot(origin: Floats, rays: Floats, center: Floats) -> list[Floats]:
    offset = origin[:2] - center
    a = (rays[..., :2] ** 2).sum(axis=-1)
    b = rays[..., :2] @ offset
    c = float(offset @ offset) - arena.ROBOT_RADIUS**2
    with np.errstate(divide="ignore", invalid="ignore"):
        side = (-b - np.sqrt(b * b - a * c)) / a
        z = origin[2] + side * rays[..., 2]
        on_side = (side > 0.0) & (z >= 0.0) & (z <= arena.ROBOT_HEIGHT)
        top = (arena.ROBOT_HEIGHT - origin[2]) / rays[..., 2]
        landing = offset + top[..., None] * rays[..., :2]
        on_top = (top > 0.0) & ((landing**2).sum(axis=-1) <= arena.ROBOT_RADIUS**2)
    return [np.where(on_side, side, np.inf), np.where(on_top, top, np.inf)]
