"""Ray casting: what the pixels of a camera meet first, exactly. One planar cast per column; no noise, no rounding.

A pixel looks along `rightward` to the right of the heading and `downward` below the horizon, both per unit of depth (see
`camera.directions`), so a ray's parameter is the depth along the optical axis. Boxes and robots are upright prisms, walls
upright and thin. `boxes` is float64 [n, 7] as in `layout.boxes_of`.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from vantage.compiled import kernel
from vantage.world.arena import ROBOT_HEIGHT, ROBOT_RADIUS, WALL_HEIGHT

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

# What a pixel sees. Two faces of a wall or box differ a little in shade; boxes add 16 * index to tell one from another.
NOTHING, FLOOR, WALL_X, WALL_Y, BOX_X, BOX_Y, BOX_TOP, ROBOT_HIDER, ROBOT_SEEKER = range(9)
BOX_STRIDE = 16


@kernel
def _cast_walls(
    rightward: Floats,
    width: float,
    depth: float,
    x: float,
    y: float,
    cosine: float,
    sine: float,
    far_out: Floats,
    surface_out: Integers,
) -> None:
    """Per column the depth at which the ray leaves the arena, and through which wall."""
    for u in range(rightward.shape[0]):
        along_x = cosine + sine * rightward[u]
        along_y = sine - cosine * rightward[u]
        along_x = along_x if along_x != 0.0 else 1e-300
        along_y = along_y if along_y != 0.0 else 1e-300
        leave_x = ((width if along_x > 0.0 else 0.0) - x) / along_x
        leave_y = ((depth if along_y > 0.0 else 0.0) - y) / along_y
        far_out[u] = leave_x if leave_x < leave_y else leave_y
        surface_out[u] = WALL_X if leave_x < leave_y else WALL_Y


@kernel
def _cast_box(
    rightward: Floats,
    boxes: Floats,
    index: int,
    x: float,
    y: float,
    cosine: float,
    sine: float,
    near_out: Floats,
    far_out: Floats,
    face_out: Integers,
) -> None:
    """Per column the depths at which the ray enters and leaves a box (inf where it misses), and the face it enters by."""
    offset_x = x - boxes[index, 0]
    offset_y = y - boxes[index, 1]
    box_cosine = boxes[index, 4]
    box_sine = boxes[index, 5]
    start_x = box_cosine * offset_x + box_sine * offset_y
    start_y = box_cosine * offset_y - box_sine * offset_x
    forward_x = box_cosine * cosine + box_sine * sine
    forward_y = box_cosine * sine - box_sine * cosine
    half_width = boxes[index, 2]
    half_depth = boxes[index, 3]
    for u in range(rightward.shape[0]):
        along_x = forward_x + forward_y * rightward[u]
        along_y = forward_y - forward_x * rightward[u]
        # An exactly parallel ray is nudged, so that no 0 * inf appears.
        inverse_x = 1.0 / (along_x if along_x != 0.0 else 1e-300)
        inverse_y = 1.0 / (along_y if along_y != 0.0 else 1e-300)
        low_x = (-half_width - start_x) * inverse_x
        high_x = (half_width - start_x) * inverse_x
        low_y = (-half_depth - start_y) * inverse_y
        high_y = (half_depth - start_y) * inverse_y
        near_x = low_x if low_x < high_x else high_x
        far_x = low_x if low_x > high_x else high_x
        near_y = low_y if low_y < high_y else high_y
        far_y = low_y if low_y > high_y else high_y
        near = near_x if near_x > near_y else near_y
        far = far_x if far_x < far_y else far_y
        near_or_here = near if near > 0.0 else 0.0
        hit = near_or_here <= far
        near_out[u] = near_or_here if hit else np.inf
        far_out[u] = far if hit else np.inf
        face_out[u] = BOX_X if near_x > near_y else BOX_Y


@kernel
def _cast_disc(
    rightward: Floats,
    x: float,
    y: float,
    cosine: float,
    sine: float,
    disc_x: float,
    disc_y: float,
    near_out: Floats,
    far_out: Floats,
) -> None:
    """Per column the depths at which the ray enters and leaves the other robot's disc, inf where it misses."""
    offset_x = disc_x - x
    offset_y = disc_y - y
    ahead = cosine * offset_x + sine * offset_y
    aside = sine * offset_x - cosine * offset_y
    beyond = ahead * ahead + aside * aside - ROBOT_RADIUS * ROBOT_RADIUS
    for u in range(rightward.shape[0]):
        square = 1.0 + rightward[u] * rightward[u]
        middle = ahead + aside * rightward[u]
        inside = middle * middle - square * beyond
        half = math.sqrt(inside if inside > 0.0 else 0.0)
        near = (middle - half) / square
        far = (middle + half) / square
        near = near if near > 0.0 else 0.0
        hit = inside >= 0.0 and near <= far
        near_out[u] = near if hit else np.inf
        far_out[u] = far if hit else np.inf


@kernel
def cast_row(
    rightward: Floats,
    mount_height: float,
    boxes: Floats,
    width: float,
    depth: float,
    x: float,
    y: float,
    heading: float,
    other_x: float,
    other_y: float,
    other_color: int,
    depths_out: Floats,
    surfaces_out: Integers,
) -> None:
    """What one horizontal row of pixels sees, exactly.

    `rightward` float64 [W] (see `directions`); pose in m and rad; other robot NaN = none; writes depth along the optical
    axis in m (0 = no return) to float64 [W] and the surface to int64 [W].
    """
    columns = rightward.shape[0]
    cosine = math.cos(heading)
    sine = math.sin(heading)
    near = np.empty(columns)
    far = np.empty(columns)
    face = np.empty(columns, np.int64)
    _cast_walls(rightward, width, depth, x, y, cosine, sine, depths_out, surfaces_out)
    if mount_height > WALL_HEIGHT:
        for u in range(columns):
            depths_out[u] = np.inf
            surfaces_out[u] = NOTHING
    for index in range(boxes.shape[0]):
        if boxes[index, 6] >= mount_height:
            _cast_box(rightward, boxes, index, x, y, cosine, sine, near, far, face)
            for u in range(columns):
                nearer = near[u] < depths_out[u]
                depths_out[u] = near[u] if nearer else depths_out[u]
                surfaces_out[u] = face[u] + BOX_STRIDE * index if nearer else surfaces_out[u]
    if mount_height <= ROBOT_HEIGHT and not math.isnan(other_x + other_y):
        _cast_disc(rightward, x, y, cosine, sine, other_x, other_y, near, far)
        for u in range(columns):
            nearer = near[u] < depths_out[u]
            depths_out[u] = near[u] if nearer else depths_out[u]
            surfaces_out[u] = ROBOT_HIDER + other_color if nearer else surfaces_out[u]
    for u in range(columns):
        depths_out[u] = depths_out[u] if 0.0 < depths_out[u] < np.inf else 0.0


@kernel
def cast_picture(
    rightward: Floats,
    downward: Floats,
    mount_height: float,
    boxes: Floats,
    width: float,
    depth: float,
    x: float,
    y: float,
    heading: float,
    other_x: float,
    other_y: float,
    other_color: int,
    depths_out: Floats,
    surfaces_out: Integers,
) -> None:
    """What every pixel sees, exactly: as `cast_row`, for float64 and int64 [H, W].

    One planar cast per column and thing; then each row's ray, as it falls or rises, meets the first thing whose front it
    passes between floor and top, or whose top it falls onto, or the floor.
    """
    columns = rightward.shape[0]
    things = boxes.shape[0] + 1
    cosine = math.cos(heading)
    sine = math.sin(heading)
    near = np.empty((things, columns))
    far = np.empty((things, columns))
    face = np.empty((things, columns), np.int64)
    top = np.empty(things)
    wall = np.empty(columns)
    wall_surface = np.empty(columns, np.int64)
    _cast_walls(rightward, width, depth, x, y, cosine, sine, wall, wall_surface)
    for index in range(boxes.shape[0]):
        _cast_box(rightward, boxes, index, x, y, cosine, sine, near[index], far[index], face[index])
        top[index] = boxes[index, 6]
    if math.isnan(other_x + other_y):
        things -= 1
    else:
        _cast_disc(rightward, x, y, cosine, sine, other_x, other_y, near[things - 1], far[things - 1])
        top[things - 1] = ROBOT_HEIGHT
    for v in range(downward.shape[0]):
        fall = downward[v]
        floor = mount_height / fall if fall > 0.0 else np.inf
        for u in range(columns):
            best = floor
            surface = FLOOR if fall > 0.0 else NOTHING
            if wall[u] <= best:
                above = mount_height - wall[u] * fall > WALL_HEIGHT
                best = np.inf if above else wall[u]
                surface = NOTHING if above else wall_surface[u]
            for thing in range(things):
                if near[thing, u] < best:
                    distance = near[thing, u]
                    is_top = mount_height - distance * fall > top[thing]
                    if is_top:
                        if fall <= 0.0:
                            continue
                        distance = (mount_height - top[thing]) / fall
                        if distance > far[thing, u] or distance >= best:
                            continue
                    best = distance
                    if thing == boxes.shape[0]:
                        surface = ROBOT_HIDER + other_color
                    else:
                        surface = BOX_STRIDE * thing + (BOX_TOP if is_top else face[thing, u])
            depths_out[v, u] = best if 0.0 < best < np.inf else 0.0
            surfaces_out[v, u] = surface
