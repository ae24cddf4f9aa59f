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
    SEEKER_COLOR,
    WALL_COLOR,
)
from vantage.world.noise import CAMERA_STREAM, gaussian_of, key_of, mix
from vantage.world.rays import BOX_STRIDE, cast_picture, cast_row

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

DEPTH_SIGMA_AT_ZERO = 0.0015
DEPTH_SIGMA_PER_SQUARE_METRE = 0.002
EDGE_JUMP = 0.030
EDGE_DROP_OUT = 0.5
COLOR_SIGMA = 3.0


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
)  # int64 [9, 3], RGB by surface (see `rays`)
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
            color = surface & (BOX_STRIDE - 1)
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
