"""The robots' RGB-D camera: a pinhole looking along the heading, cast exactly, with the noise of a stereo depth camera.

Convention (OpenCV's): integer pixel coordinates are pixel centres, so column u looks along (u - cx) / fx to the right of
the heading and row v along (v - cy) / fy below the horizon; cx = (width - 1) / 2, cy = (height - 1) / 2. The optical
centre stands over the robot's centre, whose own body is not seen. Depth is the distance along the optical axis.

Noise, like that of an active stereo camera: depth has a standard deviation of 1.5 mm + 2 mm (z / 1 m)^2 (stereo error
grows with the square of the range), is rounded to 1 mm, and drops out (0) with probability 0.5 where a neighbouring
pixel sees another surface more than 30 mm nearer or farther. Colour channels have a standard deviation of 3.
All of it depends on (seed, robot, step, pixel) only, so pictures may be rendered in any order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from schemas import Intrinsics
from vantage.compiled import kernel
from vantage.world.arena import (
    BACKGROUND_COLOR,
    BOX_COLOR,
    FLOOR_COLOR,
    HIDER_COLOR,
    MOUNT_HEIGHT,
    ROBOT_HEIGHT,
    ROBOT_RADIUS,
    SEEKER_COLOR,
    WALL_COLOR,
    WALL_HEIGHT,
)
from vantage.world.noise import CAMERA_STREAM, gaussian_of, key_of, mix

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

DEPTH_SIGMA_AT_ZERO = 0.0015
DEPTH_SIGMA_PER_SQUARE_METRE = 0.002
EDGE_JUMP = 0.030
EDGE_DROP_OUT = 0.5
COLOR_SIGMA = 3.0

# What a pixel sees. Two faces of a wall or box differ a little in shade; boxes add 16 * index to tell one from another.
NOTHING, FLOOR, WALL_X, WALL_Y, BOX_X, BOX_Y, BOX_TOP, ROBOT_HIDER, ROBOT_SEEKER = range(9)
_BOX_STRIDE = 16


def _shade(color: tuple[int, int, int], factor: float) -> list[int]:
    return [round(factor * channel) for channel in color]


SURFACE_COLORS: npt.NDArray[np.int64] = np.array(
    [
        BACKGROUND_COLOR,
        FLOOR_COLOR,
        WALL_COLOR,
        _shade(WALL_COLOR, 0.93),
        BOX_COLOR,
        _shade(BOX_COLOR, 0.85),
        _shade(BOX_COLOR, 1.12),
        HIDER_COLOR,
        SEEKER_COLOR,
    ],
    dtype=np.int64,
)  # int64 [9, 3], RGB by surface
SURFACE_COLORS.setflags(write=False)

# A channel's noise is the sum of two 8-bit parts, scaled in 16.16 fixed point.
_COLOR_SCALE = round(65536.0 * COLOR_SIGMA / math.sqrt(2.0 * (256.0**2 - 1.0) / 12.0))
_EDGE_THRESHOLD = round(65536 * EDGE_DROP_OUT)
_ODD = np.uint64(0xD1342543DE82EF95)


@dataclass(frozen=True)
class Camera:
    """A robot's RGB-D camera. One row looks horizontally."""

    width: int = 128
    """pixels"""
    height: int = 1
    """pixels"""
    horizontal_fov: float = math.radians(86.0)
    """rad, between the outer edges of the picture"""
    mount_height: float = MOUNT_HEIGHT
    """optical centre above the floor, m"""
    noise: bool = True
    """false: exact depth (rounded to 1 mm) and exact colours"""

    def __post_init__(self) -> None:
        if not (1 <= self.width <= 4096 and 1 <= self.height <= 4096):
            raise ValueError(f"camera must have 1 to 4096 columns and rows, got {self.width} x {self.height}")
        if not 0.0 < self.horizontal_fov < math.pi:
            raise ValueError(f"horizontal_fov must lie between 0 and pi rad, got {self.horizontal_fov}")
        if not 0.0 < self.mount_height <= 100.0:
            raise ValueError(f"mount_height must be above 0 m, got {self.mount_height}")

    def intrinsics(self) -> Intrinsics:
        """Focal lengths and principal point, px."""
        focal = self.width / (2.0 * math.tan(self.horizontal_fov / 2.0))
        return Intrinsics(
            fx=focal, fy=focal, cx=(self.width - 1) / 2.0, cy=(self.height - 1) / 2.0, mount_height=self.mount_height
        )


@lru_cache(maxsize=64)
def directions(camera: Camera) -> tuple[Floats, Floats]:
    """Slopes of a camera's columns to the right, float64 [W], and of its rows downward, float64 [H], per unit of depth."""
    pinhole = camera.intrinsics()
    rightward = (np.arange(camera.width, dtype=np.float64) - pinhole.cx) / np.float64(pinhole.fx)
    downward = (np.arange(camera.height, dtype=np.float64) - pinhole.cy) / np.float64(pinhole.fy)
    rightward.setflags(write=False)
    downward.setflags(write=False)
    return rightward, downward


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
                surfaces_out[u] = face[u] + _BOX_STRIDE * index if nearer else surfaces_out[u]
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
                        surface = _BOX_STRIDE * thing + (BOX_TOP if is_top else face[thing, u])
            depths_out[v, u] = best if 0.0 < best < np.inf else 0.0
            surfaces_out[v, u] = surface


@kernel
def _differs(depth: float, surface: int, other_depth: float, other_surface: int) -> bool:
    return surface != other_surface and abs(depth - other_depth) > EDGE_JUMP


@kernel
def expose(
    depths: Floats,
    surfaces: Integers,
    noise: bool,
    seed: int,
    step: int,
    robot_index: int,
    depth_out: npt.NDArray[np.uint16],
    color_out: npt.NDArray[np.uint8],
) -> None:
    """Turn what the pixels see into the camera's picture: noise, drop-outs, quantisation.

    depths float64 and surfaces int64 [H, W] -> uint16 [H, W] mm and uint8 [H, W, 3] RGB.
    """
    rows, columns = depths.shape
    key = key_of(seed, CAMERA_STREAM, robot_index, step)
    for v in range(rows):
        for u in range(columns):
            depth = depths[v, u]
            surface = surfaces[v, u]
            color = surface & (_BOX_STRIDE - 1)
            if not noise:
                depth_out[v, u] = np.uint16(min(depth * 1000.0 + 0.5, 65535.0))
                for channel in range(3):
                    color_out[v, u, channel] = np.uint8(SURFACE_COLORS[color, channel])
                continue
            bits = mix(key + np.uint64(v * columns + u) * _ODD)
            sigma = DEPTH_SIGMA_AT_ZERO + DEPTH_SIGMA_PER_SQUARE_METRE * depth * depth
            noisy = (depth + sigma * gaussian_of(bits)) * 1000.0 + 0.5
            noisy = min(max(noisy, 1.0), 65535.0) if depth > 0.0 else 0.0
            more = np.int64(mix(bits) >> np.uint64(1))
            edge = (u > 0 and _differs(depth, surface, depths[v, u - 1], surfaces[v, u - 1])) or (
                u + 1 < columns and _differs(depth, surface, depths[v, u + 1], surfaces[v, u + 1])
            )
            if rows > 1 and not edge:
                edge = (v > 0 and _differs(depth, surface, depths[v - 1, u], surfaces[v - 1, u])) or (
                    v + 1 < rows and _differs(depth, surface, depths[v + 1, u], surfaces[v + 1, u])
                )
            if edge and (more & 0xFFFF) < _EDGE_THRESHOLD:
                noisy = 0.0
            depth_out[v, u] = np.uint16(noisy)
            for channel in range(3):
                part = more >> (15 + 16 * channel)
                offset = (((part & 0xFF) + ((part >> 8) & 0xFF) - 255) * _COLOR_SCALE + 32768) >> 16
                color_out[v, u, channel] = np.uint8(min(max(SURFACE_COLORS[color, channel] + offset, 0), 255))


@kernel
def render_picture(
    rightward: Floats,
    downward: Floats,
    mount_height: float,
    noise: bool,
    boxes: Floats,
    width: float,
    depth: float,
    x: float,
    y: float,
    heading: float,
    other_x: float,
    other_y: float,
    other_color: int,
    seed: int,
    step: int,
    robot_index: int,
    depth_out: npt.NDArray[np.uint16],
    color_out: npt.NDArray[np.uint8],
) -> None:
    """`render` for compiled callers: the camera comes as its `directions`, mount height and noise switch."""
    rows = downward.shape[0]
    depths = np.empty((rows, rightward.shape[0]))
    surfaces = np.empty((rows, rightward.shape[0]), np.int64)
    if rows == 1:
        cast_row(
            rightward, mount_height, boxes, width, depth, x, y, heading, other_x, other_y, other_color, depths[0], surfaces[0]
        )
    else:
        cast_picture(
            rightward, downward, mount_height, boxes, width, depth, x, y, heading, other_x, other_y, other_color, depths, surfaces
        )
    expose(depths, surfaces, noise, seed, step, robot_index, depth_out, color_out)


def render(
    camera: Camera,
    boxes: Floats,
    width: float,
    depth: float,
    x: float,
    y: float,
    heading: float,
    other_x: float,
    other_y: float,
    other_color: int,
    seed: int,
    step: int,
    robot_index: int,
    depth_out: npt.NDArray[np.uint16],
    color_out: npt.NDArray[np.uint8],
) -> None:
    """Render one picture of a robot's camera.

    boxes float64 [n, 7]; arena, poses in m, heading in rad; the other robot at NaN = none, its colour 0 hider or 1
    seeker. Writes depth uint16 [H, W] (mm along the optical axis, 0 = no return) and colour uint8 [H, W, 3] (RGB).
    Raises ValueError when the arrays do not fit the camera.
    """
    if depth_out.shape != (camera.height, camera.width) or color_out.shape != (camera.height, camera.width, 3):
        raise ValueError(
            f"a {camera.width} x {camera.height} camera needs depth [{camera.height}, {camera.width}] and colour "
            f"[{camera.height}, {camera.width}, 3], got {depth_out.shape} and {color_out.shape}"
        )
    rightward, downward = directions(camera)
    render_picture(
        rightward,
        downward,
        float(camera.mount_height),
        bool(camera.noise),
        boxes,
        float(width),
        float(depth),
        float(x),
        float(y),
        float(heading),
        float(other_x),
        float(other_y),
        int(other_color),
        int(seed),
        int(step),
        int(robot_index),
        depth_out,
        color_out,
    )
