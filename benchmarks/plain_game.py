"""The whole game step in plain numpy and Python: what the compiled kernels are measured against.

Written as one would write it without a compiler (arrays over columns, boxes and pixels), not to be slow. The centre of
the other robot is taken from the mean of its columns; all else computes what the kernels compute.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from vantage.perception.palette import BOUNDARY, FREE, INVISIBLE, OTHER, OWN, PIXEL_SIZE
from vantage.perception.scan import COLOR_DISTANCE
from vantage.world import arena
from vantage.world.camera import (
    COLOR_SIGMA,
    DEPTH_SIGMA_AT_ZERO,
    DEPTH_SIGMA_PER_SQUARE_METRE,
    EDGE_DROP_OUT,
    EDGE_JUMP,
    SURFACE_COLORS,
    Camera,
    directions,
)
from vantage.world.motion import heading_radians
from vantage.world.rays import BOX_X, BOX_Y, ROBOT_HIDER, WALL_X, WALL_Y

Floats = npt.NDArray[np.float64]

_CAMERA = Camera()
_RIGHTWARD, _ = directions(_CAMERA)
_PINHOLE = _CAMERA.intrinsics()
_ROBOT_COLORS = np.array([arena.HIDER_COLOR, arena.SEEKER_COLOR], dtype=np.float64)
_CHROMATICITIES = _ROBOT_COLORS / _ROBOT_COLORS.sum(axis=1, keepdims=True)
_CENTERS = (np.arange(128) + 0.5) * PIXEL_SIZE
_PIXEL_X = np.broadcast_to(_CENTERS, (128, 128))
_PIXEL_Y = np.broadcast_to((arena.ARENA_SIZE - _CENTERS)[:, None], (128, 128))


def cast(boxes: Floats, pose: Floats, other: Floats, other_color: int) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Depth in m and surface per column, float64 and int64 [128]."""
    x, y, heading = pose[0], pose[1], heading_radians(int(pose[2]))
    cosine, sine = math.cos(heading), math.sin(heading)
    along_x = cosine + sine * _RIGHTWARD
    along_y = sine - cosine * _RIGHTWARD
    with np.errstate(divide="ignore", invalid="ignore"):
        leave_x = (np.where(along_x > 0.0, arena.ARENA_SIZE, 0.0) - x) / along_x
        leave_y = (np.where(along_y > 0.0, arena.ARENA_SIZE, 0.0) - y) / along_y
        start = np.stack(
            (
                boxes[:, 4] * (x - boxes[:, 0]) + boxes[:, 5] * (y - boxes[:, 1]),
                boxes[:, 4] * (y - boxes[:, 1]) - boxes[:, 5] * (x - boxes[:, 0]),
            )
        )[:, :, None]  # [2, n, 1]
        along = np.stack(
            (
                boxes[:, 4, None] * along_x + boxes[:, 5, None] * along_y,
                boxes[:, 4, None] * along_y - boxes[:, 5, None] * along_x,
            )
        )  # [2, n, 128]
        half = boxes[:, 2:4].T[:, :, None]
        low, high = (-half - start) / along, (half - start) / along
    near, far = np.minimum(low, high), np.maximum(low, high)
    enter, leave = near.max(axis=0), far.min(axis=0)
    box_depths = np.where((np.maximum(enter, 0.0) <= leave), enter, np.inf)
    box_surfaces = np.where(near[0] > near[1], BOX_X, BOX_Y) + 16 * np.arange(len(boxes))[:, None]
    offset_x, offset_y = other[0] - x, other[1] - y
    ahead, aside = cosine * offset_x + sine * offset_y, sine * offset_x - cosine * offset_y
    square = 1.0 + _RIGHTWARD**2
    middle = ahead + aside * _RIGHTWARD
    inside = middle**2 - square * (ahead**2 + aside**2 - arena.ROBOT_RADIUS**2)
    disc = (middle - np.sqrt(np.maximum(inside, 0.0))) / square
    disc = np.where((inside >= 0.0) & (disc > 0.0), disc, np.inf)
    depths = np.vstack((np.minimum(leave_x, leave_y), box_depths, disc))
    surfaces = np.vstack(
        (np.where(leave_x < leave_y, WALL_X, WALL_Y), box_surfaces, np.full(len(_RIGHTWARD), ROBOT_HIDER + other_color))
    )
    first = depths.argmin(axis=0)
    columns = np.arange(len(_RIGHTWARD))
    return depths[first, columns], surfaces[first, columns]


def expose(
    depths: Floats, surfaces: npt.NDArray[np.int64], random: np.random.Generator
) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint8]]:
    """Noise, drop-outs and quantisation: uint16 [128] mm, uint8 [128, 3]."""
    sigma = DEPTH_SIGMA_AT_ZERO + DEPTH_SIGMA_PER_SQUARE_METRE * depths**2
    noisy = np.maximum((depths + sigma * random.standard_normal(len(depths))) * 1000.0 + 0.5, 1.0).astype(np.uint16)
    jump = (np.abs(np.diff(depths)) > EDGE_JUMP) & (np.diff(surfaces) != 0)
    edge = np.zeros(len(depths), np.bool_)
    edge[1:] |= jump
    edge[:-1] |= jump
    noisy[edge & (random.random(len(depths)) < EDGE_DROP_OUT)] = 0
    color = SURFACE_COLORS[surfaces & 15] + np.rint(COLOR_SIGMA * random.standard_normal((len(depths), 3)))
    return noisy, np.clip(color, 0, 255).astype(np.uint8)


def state_image(
    depth: npt.NDArray[np.uint16], color: npt.NDArray[np.uint8], pose: Floats, other_color: int
) -> npt.NDArray[np.uint8]:
    """Both column scans and the state image of one view: uint8 [128, 128]."""
    x, y, heading = pose[0], pose[1], heading_radians(int(pose[2]))
    cosine, sine = math.cos(heading), math.sin(heading)
    chromaticity = color / np.maximum(color.sum(axis=1, keepdims=True), 1)
    is_other = (np.square(chromaticity - _CHROMATICITIES[other_color]).sum(axis=1) < COLOR_DISTANCE**2) & (depth > 0)
    ranges = depth * 0.001
    holes = np.flatnonzero(depth == 0)
    ranges[holes] = np.minimum(ranges[np.maximum(holes - 1, 0)], ranges[np.minimum(holes + 1, len(ranges) - 1)])
    ahead = (_PIXEL_X - x) * cosine + (_PIXEL_Y - y) * sine
    right = (_PIXEL_X - x) * sine - (_PIXEL_Y - y) * cosine
    with np.errstate(divide="ignore", invalid="ignore"):
        column = np.rint(right / ahead * _PINHOLE.fx + _PINHOLE.cx)
    within = (ahead > 0.0) & (column >= 0) & (column < len(ranges))
    reach = ranges[np.where(within, column, 0).astype(np.int64)]
    image = np.where(within & (ahead <= reach), FREE, INVISIBLE).astype(np.uint8)
    ends = np.flatnonzero(~is_other & (depth > 0))
    end_x = x + ranges[ends] * (cosine + sine * _RIGHTWARD[ends])
    end_y = y + ranges[ends] * (sine - cosine * _RIGHTWARD[ends])
    row = np.clip(((arena.ARENA_SIZE - end_y) / PIXEL_SIZE).astype(np.int64), 0, 127)
    image[row, np.clip((end_x / PIXEL_SIZE).astype(np.int64), 0, 127)] = BOUNDARY
    seen = np.flatnonzero(is_other)
    if len(seen) >= 2:
        distance = ranges[seen].mean() + 0.75 * arena.ROBOT_RADIUS
        aside = distance * _RIGHTWARD[seen].mean()
        other_x, other_y = x + distance * cosine + aside * sine, y + distance * sine - aside * cosine
        image[np.square(_PIXEL_X - other_x) + np.square(_PIXEL_Y - other_y) <= arena.ROBOT_RADIUS**2] = OTHER
    image[np.square(_PIXEL_X - x) + np.square(_PIXEL_Y - y) <= arena.ROBOT_RADIUS**2] = OWN
    return image


def _free(boxes: Floats, x: float, y: float) -> bool:
    radius = arena.ROBOT_RADIUS - 1e-9
    if not (radius <= x <= arena.ARENA_SIZE - radius and radius <= y <= arena.ARENA_SIZE - radius):
        return False
    for box_x, box_y, half_width, half_depth, cosine, sine, _ in boxes.tolist():
        local_x = abs(cosine * (x - box_x) + sine * (y - box_y)) - half_width
        local_y = abs(cosine * (y - box_y) - sine * (x - box_x)) - half_depth
        if math.hypot(max(local_x, 0.0), max(local_y, 0.0)) < radius:
            return False
    return True


def move(boxes: Floats, pose: Floats, other: Floats, primitive: int) -> Floats:
    """The pose after one primitive, float64 [3]."""
    x, y, heading = pose.tolist()
    if primitive == arena.LEFT:
        return np.array([x, y, (heading + 1) % 36])
    if primitive == arena.RIGHT:
        return np.array([x, y, (heading + 35) % 36])
    length = {arena.FORWARD: arena.STEP_LENGTH, arena.BACKWARD: -arena.STEP_LENGTH}.get(primitive, 0.0)
    new_x = x + length * math.cos(heading_radians(int(heading)))
    new_y = y + length * math.sin(heading_radians(int(heading)))
    if math.hypot(new_x - other[0], new_y - other[1]) < 2 * arena.ROBOT_RADIUS - 1e-9 or not _free(boxes, new_x, new_y):
        return pose
    return np.array([new_x, new_y, heading])


def step(
    boxes: Floats, poses: Floats, primitives: npt.NDArray[np.int64], random: np.random.Generator
) -> tuple[Floats, npt.NDArray[np.uint8], bool]:
    """One whole game step: new poses float64 [2, 3], both state images uint8 [2, 128, 128], caught."""
    moved = np.stack([move(boxes, poses[robot], poses[1 - robot], int(primitives[robot])) for robot in range(2)])
    images = np.empty((2, 128, 128), np.uint8)
    for robot in range(2):
        depth, color = expose(*cast(boxes, moved[robot], moved[1 - robot], 1 - robot), random)
        images[robot] = state_image(depth, color, moved[robot], 1 - robot)
    return moved, images, math.hypot(*(moved[0, :2] - moved[1, :2])) <= arena.CATCH_DISTANCE + 1e-9
