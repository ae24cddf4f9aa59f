"""Compiled steps of `rgbd_picture`: what each pixel of a tilted, distorted lens meets, and what the sensors make of it."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from vantage.compiled import kernel
from vantage.world.arena import ROBOT_HEIGHT, ROBOT_RADIUS, WALL_HEIGHT
from vantage.world.camera import (
    COLOR_SIGMA,
    DEPTH_SIGMA_AT_ZERO,
    DEPTH_SIGMA_PER_SQUARE_METRE,
    EDGE_JUMP,
    SURFACE_COLORS,
)
from vantage.world.noise import gaussian_of, key_of, mix
from vantage.world.rays import BOX_STRIDE, BOX_TOP, BOX_X, BOX_Y, FLOOR, NOTHING, ROBOT_HIDER, WALL_X, WALL_Y

Floats = npt.NDArray[np.float64]
Floats32 = npt.NDArray[np.float32]
Depths = npt.NDArray[np.uint16]
Bytes = npt.NDArray[np.uint8]
Surfaces = npt.NDArray[np.int32]

DEPTH_STREAM = 40
BLOCK_STREAM = 41
HOLE_STREAM = 42
COLOR_STREAM = 43

BLOCK = 6
"""px: half of the variance of depth is common to blocks of this side, as a stereo camera's matching window makes it."""
SMALLEST_HOLE = 2.0
LARGEST_HOLE = 7.0
"""Radii of the blotches without return, px."""

_ODD = np.uint64(0xD1342543DE82EF95)
_HALF = math.sqrt(0.5)
_COLOR_SCALE = COLOR_SIGMA / math.sqrt(2.0 * (256.0**2 - 1.0) / 12.0)  # of the sum of two 8-bit parts


@kernel
def _box_sides(
    ahead: float, right: float, forward_x: float, forward_y: float, half_width: float, half_depth: float
) -> tuple[float, float]:
    """Least and greatest right / ahead of a box's corners; without bounds where a corner is not clearly ahead."""
    low = np.inf
    high = -np.inf
    for corner in range(4):
        along = half_width if corner & 1 else -half_width
        across = half_depth if corner & 2 else -half_depth
        # The box's own x axis points (forward_x ahead, forward_y to the right), its y axis a quarter turn on.
        corner_ahead = ahead + along * forward_x - across * forward_y
        corner_right = right + along * forward_y + across * forward_x
        if corner_ahead < 1e-6:
            return -np.inf, np.inf
        low = min(low, corner_right / corner_ahead)
        high = max(high, corner_right / corner_ahead)
    return low - 1e-9, high + 1e-9


@kernel
def cast_pixels(
    rightward: Floats32,  # [H, W]: right per unit ahead of each pixel's ray, level frame
    downward: Floats32,  # [H, W]: down per unit ahead
    height: float,
    boxes: Floats,  # [n, 7]
    width: float,
    depth: float,
    x: float,
    y: float,
    heading: float,
    other_x: float,
    other_y: float,
    other_color: int,
    ahead_out: Floats32,  # [H, W]
    surfaces_out: Surfaces,  # [H, W]
) -> None:
    """What every pixel sees first, as `vantage.world.rays.cast_picture`, for rays in any direction.

    `x`, `y`, `height`: optical centre, m. Writes the distance along the heading in m (0 = nothing) and the surface.
    """
    rows, columns = rightward.shape
    cosine = math.cos(heading)
    sine = math.sin(heading)
    count = boxes.shape[0]
    start_x = np.empty(count)
    start_y = np.empty(count)
    forward_x = np.empty(count)
    forward_y = np.empty(count)
    low = np.empty(count + 1)
    high = np.empty(count + 1)
    for index in range(count):
        offset_x = x - boxes[index, 0]
        offset_y = y - boxes[index, 1]
        start_x[index] = boxes[index, 4] * offset_x + boxes[index, 5] * offset_y
        start_y[index] = boxes[index, 4] * offset_y - boxes[index, 5] * offset_x
        forward_x[index] = boxes[index, 4] * cosine + boxes[index, 5] * sine
        forward_y[index] = boxes[index, 4] * sine - boxes[index, 5] * cosine
        ahead = -(cosine * offset_x + sine * offset_y)
        right = -(sine * offset_x - cosine * offset_y)
        low[index], high[index] = _box_sides(ahead, right, forward_x[index], forward_y[index], boxes[index, 2], boxes[index, 3])
    disc_ahead = 0.0
    disc_right = 0.0
    beyond = 0.0
    has_other = not math.isnan(other_x + other_y)
    low[count] = np.inf
    high[count] = -np.inf
    if has_other:
        disc_ahead = cosine * (other_x - x) + sine * (other_y - y)
        disc_right = sine * (other_x - x) - cosine * (other_y - y)
        beyond = disc_ahead * disc_ahead + disc_right * disc_right - ROBOT_RADIUS * ROBOT_RADIUS
        if disc_ahead > -ROBOT_RADIUS:
            low[count] = -np.inf
            high[count] = np.inf
            if disc_ahead > 1.01 * ROBOT_RADIUS:
                nearer = disc_ahead - ROBOT_RADIUS
                farther = disc_ahead + ROBOT_RADIUS
                low[count] = min((disc_right - ROBOT_RADIUS) / nearer, (disc_right - ROBOT_RADIUS) / farther)
                high[count] = max((disc_right + ROBOT_RADIUS) / nearer, (disc_right + ROBOT_RADIUS) / farther)
    for v in range(rows):
        for u in range(columns):
            a = float(rightward[v, u])
            fall = float(downward[v, u])
            along_x = cosine + sine * a
            along_y = sine - cosine * a
            along_x = along_x if along_x != 0.0 else 1e-300
            along_y = along_y if along_y != 0.0 else 1e-300
            leave_x = ((width if along_x > 0.0 else 0.0) - x) / along_x
            leave_y = ((depth if along_y > 0.0 else 0.0) - y) / along_y
            wall = leave_x if leave_x < leave_y else leave_y
            best = height / fall if fall > 0.0 else np.inf
            surface = FLOOR if fall > 0.0 else NOTHING
            if wall <= best:
                above = height - wall * fall > WALL_HEIGHT
                best = np.inf if above else wall
                surface = NOTHING if above else (WALL_X if leave_x < leave_y else WALL_Y)
            for index in range(count):
                if a < low[index] or a > high[index]:
                    continue
                step_x = forward_x[index] + forward_y[index] * a
                step_y = forward_y[index] - forward_x[index] * a
                inverse_x = 1.0 / (step_x if step_x != 0.0 else 1e-300)
                inverse_y = 1.0 / (step_y if step_y != 0.0 else 1e-300)
                one = (-boxes[index, 2] - start_x[index]) * inverse_x
                two = (boxes[index, 2] - start_x[index]) * inverse_x
                three = (-boxes[index, 3] - start_y[index]) * inverse_y
                four = (boxes[index, 3] - start_y[index]) * inverse_y
                near_x = min(one, two)
                near_y = min(three, four)
                far = min(max(one, two), max(three, four))
                near = max(near_x, near_y, 0.0)
                if near > far or near >= best:
                    continue
                if height - near * fall > boxes[index, 6]:
                    if fall <= 0.0:
                        continue
                    near = (height - boxes[index, 6]) / fall
                    if near > far or near >= best:
                        continue
                    surface = BOX_STRIDE * index + BOX_TOP
                else:
                    surface = BOX_STRIDE * index + (BOX_X if near_x > near_y else BOX_Y)
                best = near
            if low[count] <= a <= high[count]:
                square = 1.0 + a * a
                middle = disc_ahead + disc_right * a
                inside = middle * middle - square * beyond
                if inside >= 0.0:
                    root = math.sqrt(inside)
                    near = max((middle - root) / square, 0.0)
                    far = (middle + root) / square
                    if near <= far and near < best:
                        if height - near * fall > ROBOT_HEIGHT:
                            near = (height - ROBOT_HEIGHT) / fall if fall > 0.0 else np.inf
                        if near <= far and near < best:
                            best = near
                            surface = ROBOT_HIDER + other_color
            ahead_out[v, u] = np.float32(best) if 0.0 < best < np.inf else np.float32(0.0)
            surfaces_out[v, u] = surface


@kernel
def expose_depth(
    ahead: Floats32,  # [H, W]
    surfaces: Surfaces,  # [H, W]
    per_ahead: Floats32,  # [H, W]: depth along the lens's axis per distance along the heading
    unit: float,
    noise: float,
    edge_drop_out: float,
    flying: float,
    holes: float,
    stereo_shift: float,
    seed: int,
    frame: int,
    robot_index: int,
    block_noise: Floats32,  # [>= H / BLOCK + 1, >= W / BLOCK + 1], scratch
    depth_out: Depths,  # [H, W]
) -> None:
    """Depth as the sensor gives it: noise, quantisation; at edges drop-outs and flying pixels; stereo shadows; blotches.

    `stereo_shift`: focal length times baseline of the stereo pair, px m; what its second imager, to the right, does not see
    has no depth. 0 = no such shadow.
    """
    rows, columns = ahead.shape
    for block_v in range((rows + BLOCK - 1) // BLOCK):
        key = key_of(seed, BLOCK_STREAM, robot_index * 1_000_003 + frame, block_v)
        for block_u in range((columns + BLOCK - 1) // BLOCK):
            block_noise[block_v, block_u] = np.float32(_HALF * gaussian_of(mix(key + np.uint64(block_u) * _ODD)))
    key = key_of(seed, DEPTH_STREAM, robot_index, frame)
    threshold = np.int64(65536.0 * edge_drop_out)
    flying_threshold = np.int64(65536.0 * flying)
    per_unit = 1.0 / unit
    for v in range(rows):
        block_v = v // BLOCK
        leftmost = np.inf
        for back in range(columns):
            u = columns - 1 - back
            z_ahead = ahead[v, u]
            if z_ahead <= 0.0:
                depth_out[v, u] = 0
                continue
            z = float(z_ahead) * per_ahead[v, u]
            if stereo_shift > 0.0:
                place = u - stereo_shift / z
                if place >= leftmost + 0.5:
                    depth_out[v, u] = 0
                    continue
                leftmost = min(leftmost, place)
            bits = mix(key + np.uint64(v * columns + u) * _ODD)
            surface = surfaces[v, u]
            beside = z_ahead
            if u > 0 and surfaces[v, u - 1] != surface and abs(ahead[v, u - 1] - z_ahead) > EDGE_JUMP:
                beside = ahead[v, u - 1]
            elif u + 1 < columns and surfaces[v, u + 1] != surface and abs(ahead[v, u + 1] - z_ahead) > EDGE_JUMP:
                beside = ahead[v, u + 1]
            elif v > 0 and surfaces[v - 1, u] != surface and abs(ahead[v - 1, u] - z_ahead) > EDGE_JUMP:
                beside = ahead[v - 1, u]
            elif v + 1 < rows and surfaces[v + 1, u] != surface and abs(ahead[v + 1, u] - z_ahead) > EDGE_JUMP:
                beside = ahead[v + 1, u]
            if beside != z_ahead:
                more = mix(bits)
                if np.int64(more & np.uint64(0xFFFF)) < threshold:
                    depth_out[v, u] = 0
                    continue
                if beside > 0.0 and np.int64((more >> np.uint64(16)) & np.uint64(0xFFFF)) < flying_threshold:
                    part = np.float64((more >> np.uint64(32)) & np.uint64(0xFFFF)) / 65536.0
                    z += part * (float(beside) * per_ahead[v, u] - z)
            sigma = noise * (DEPTH_SIGMA_AT_ZERO + DEPTH_SIGMA_PER_SQUARE_METRE * z * z)
            error = sigma * (_HALF * gaussian_of(bits) + block_noise[block_v, u // BLOCK])
            depth_out[v, u] = np.uint16(min(max((z + error) * per_unit + 0.5, 1.0), 65535.0))
    mean_area = math.pi * (SMALLEST_HOLE**2 + SMALLEST_HOLE * LARGEST_HOLE + LARGEST_HOLE**2) / 3.0
    blotches = int(holes * rows * columns / mean_area + 0.5)
    for number in range(blotches):
        bits = key_of(seed, HOLE_STREAM, robot_index * 1_000_003 + frame, number)
        middle_u = np.float64(bits & np.uint64(0xFFFF)) / 65536.0 * columns
        middle_v = np.float64((bits >> np.uint64(16)) & np.uint64(0xFFFF)) / 65536.0 * rows
        part = np.float64((bits >> np.uint64(32)) & np.uint64(0xFFFF)) / 65536.0
        radius = SMALLEST_HOLE + (LARGEST_HOLE - SMALLEST_HOLE) * part
        for v in range(max(0, int(middle_v - radius)), min(rows, int(middle_v + radius) + 1)):
            for u in range(max(0, int(middle_u - radius)), min(columns, int(middle_u + radius) + 1)):
                if (u - middle_u) ** 2 + (v - middle_v) ** 2 <= radius * radius:
                    depth_out[v, u] = 0


@kernel
def expose_color(
    ahead: Floats32,  # [H, W]
    surfaces: Surfaces,  # [H, W]
    rightward: Floats32,  # [H, W]
    x: float,
    y: float,
    heading: float,
    width: float,
    gains: Floats,  # [3]
    unevenness: float,
    noise: float,
    seed: int,
    frame: int,
    robot_index: int,
    color_out: Bytes,  # [H, W, 3]
) -> None:
    """Colour as the sensor gives it: surface colour x light at the place x gain, noise of 3, cut at 0 and 255.

    The light falls from 1 + unevenness / 2 at the arena's left to 1 - unevenness / 2 at its right.
    """
    rows, columns = ahead.shape
    cosine = math.cos(heading)
    sine = math.sin(heading)
    key = key_of(seed, COLOR_STREAM, robot_index, frame)
    scale = noise * _COLOR_SCALE
    for v in range(rows):
        for u in range(columns):
            place = x + ahead[v, u] * (cosine + sine * rightward[v, u])
            light = 1.0 + unevenness * (0.5 - min(max(place / width, 0.0), 1.0))
            surface = surfaces[v, u] & (BOX_STRIDE - 1)
            more = np.int64(mix(key + np.uint64(v * columns + u) * _ODD) >> np.uint64(1))
            for channel in range(3):
                part = more >> (15 + 16 * channel)
                offset = ((part & 0xFF) + ((part >> 8) & 0xFF) - 255) * scale
                value = SURFACE_COLORS[surface, channel] * gains[channel] * light + offset + 0.5
                color_out[v, u, channel] = np.uint8(min(max(value, 0.0), 255.0))
