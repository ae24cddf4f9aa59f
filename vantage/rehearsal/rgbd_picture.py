"""What an RGB-D camera on a robot gives: two lenses apart, tilted, with the noise, holes and light of a real table."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from vantage.rehearsal.rgbd_cast import BLOCK, cast_pixels, expose_color, expose_depth
from vantage.tracking.rgbd import RgbdCalibration, default_rgbd, level_rotation
from vantage.tracking.rgbd_lens import Lens, pixel_rays

Floats = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]
Depths = npt.NDArray[np.uint16]


@dataclass(frozen=True)
class RgbdLook:
    """How a rendered RGB-D camera errs."""

    noise: float = 1.0
    """scales the standard deviation of depth (1.5 mm + 2 mm (z / 1 m)^2) and colour (3)"""
    edge_drop_out: float = 0.5
    """probability of a hole beside an edge"""
    flying: float = 0.3
    """probability of a depth anywhere between the two surfaces, beside an edge where there is no hole"""
    holes: float = 0.01
    """share of the depth picture in blotches without return"""
    red_gain: float = 1.0
    green_gain: float = 1.0
    blue_gain: float = 1.0
    brightness: float = 1.0
    unevenness: float = 0.15
    """by which the light falls off from one side of the table to the other, share"""
    stereo_baseline: float = 0.0
    """m between the imagers of a stereo depth camera: beside a near thing, what only one sees has no depth; 0 = no stereo"""

    def __post_init__(self) -> None:
        chances = (self.edge_drop_out, self.flying, 2.0 * self.holes)
        if not (all(0.0 <= chance <= 1.0 for chance in chances) and self.noise >= 0.0 and self.stereo_baseline >= 0.0):
            raise ValueError("edge_drop_out and flying must be in 0..1, holes in 0..0.5, noise and stereo_baseline 0 or more")
        if min(self.red_gain, self.green_gain, self.blue_gain, self.brightness) < 0.0 or not 0.0 <= self.unevenness <= 1.0:
            raise ValueError("gains and brightness must be 0 or more, unevenness in 0..1")


@dataclass(frozen=True)
class RgbdCamera:
    """The physical camera of one robot."""

    geometry: RgbdCalibration = field(default_factory=default_rgbd)
    """where its lenses truly are (a tracker may believe something else)"""
    look: RgbdLook = field(default_factory=RgbdLook)


def render_rgbd(
    camera: RgbdCamera,
    boxes: Floats,
    pose: tuple[float, float, float],
    other: tuple[float, float] | None,
    other_color: int,
    seed: int,
    frame: int,
    robot_index: int,
    width: float = 1.2,
    depth: float = 1.2,
) -> tuple[Depths, Bytes]:
    """Depth uint16 [H, W] in counts of the camera's unit (0 = no return) and colour uint8 [H, W, 3] RGB.

    boxes float64 [n, 7] as `layout.boxes_of`; pose x, y m and heading rad of this robot's centre; other: centre of the other
    robot, m, None = nowhere; its colour 0 hider, 1 seeker; the picture depends on (seed, frame, robot_index) and the scene only;
    width, depth: the arena, m.
    """
    sensors = _sensors(camera.geometry)
    look = camera.look
    x, y, heading = pose
    other_x, other_y = (math.nan, math.nan) if other is None else other
    unit = camera.geometry.depth_unit
    scene = (boxes, float(width), float(depth))
    others = (float(other_x), float(other_y), int(other_color))
    counters = (int(seed), int(frame), int(robot_index))

    lens = sensors.depth
    lens_x, lens_y = lens.place(x, y, heading)
    ahead, surfaces = lens.cast(lens_x, lens_y, heading, scene, others)
    depth_out = np.empty(ahead.shape, np.uint16)
    rows, columns = ahead.shape
    expose_depth(
        ahead,
        surfaces,
        lens.per_ahead,
        unit,
        float(look.noise),
        float(look.edge_drop_out),
        float(look.flying),
        float(look.holes),
        float(look.stereo_baseline * camera.geometry.depth.fx),
        *counters,
        np.empty((rows // BLOCK + 1, columns // BLOCK + 1), np.float32),
        depth_out,
    )

    lens = sensors.color
    lens_x, lens_y = lens.place(x, y, heading)
    ahead, surfaces = lens.cast(lens_x, lens_y, heading, scene, others)
    color_out = np.empty((*ahead.shape, 3), np.uint8)
    gains = look.brightness * np.array([look.red_gain, look.green_gain, look.blue_gain], dtype=np.float64)
    expose_color(
        ahead,
        surfaces,
        lens.rightward,
        lens_x,
        lens_y,
        float(heading),
        float(width),
        gains,
        float(look.unevenness),
        float(look.noise),
        *counters,
        color_out,
    )
    return depth_out, color_out


@dataclass(frozen=True)
class _Sensor:
    """One lens in the level frame of its robot."""

    right: float
    """m to the right of the robot's centre"""
    height: float
    """m above the floor"""
    ahead: float
    """m ahead of the robot's centre"""
    rightward: npt.NDArray[np.float32]
    """[H, W]"""
    downward: npt.NDArray[np.float32]
    """[H, W]"""
    per_ahead: npt.NDArray[np.float32]
    """[H, W]"""

    def place(self, x: float, y: float, heading: float) -> tuple[float, float]:
        cosine, sine = math.cos(heading), math.sin(heading)
        return x + self.ahead * cosine + self.right * sine, y + self.ahead * sine - self.right * cosine

    def cast(
        self, x: float, y: float, heading: float, scene: tuple[Floats, float, float], other: tuple[float, float, int]
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]]:
        ahead = np.empty(self.rightward.shape, np.float32)
        surfaces = np.empty(self.rightward.shape, np.int32)
        cast_pixels(
            self.rightward, self.downward, self.height, *scene, float(x), float(y), float(heading), *other, ahead, surfaces
        )
        return ahead, surfaces


@dataclass(frozen=True)
class _Sensors:
    depth: _Sensor
    color: _Sensor


def _sensor(lens: Lens, to_level: Floats, origin: Floats, mount_height: float) -> _Sensor:
    slopes = pixel_rays(lens)
    rays = np.concatenate((slopes, np.ones((lens.height, lens.width, 1))), axis=-1) @ to_level.T
    if np.min(rays[..., 2]) < 0.05:
        raise ValueError("the camera's picture reaches 90 degrees from the heading; tilt it less or give it a narrower lens")
    return _Sensor(
        right=float(origin[0]),
        height=mount_height - float(origin[1]),
        ahead=float(origin[2]),
        rightward=(rays[..., 0] / rays[..., 2]).astype(np.float32),
        downward=(rays[..., 1] / rays[..., 2]).astype(np.float32),
        per_ahead=(1.0 / rays[..., 2]).astype(np.float32),
    )


@lru_cache(maxsize=8)
def _sensors(geometry: RgbdCalibration) -> _Sensors:
    rotation = np.array(geometry.rotation, dtype=np.float64).reshape(3, 3)
    shift = np.array(geometry.translation, dtype=np.float64)
    to_level = level_rotation(geometry.tilt)
    origin = np.array([-geometry.left, 0.0, geometry.forward])
    return _Sensors(
        _sensor(geometry.depth, to_level, origin, geometry.mount_height),
        _sensor(geometry.color, to_level @ rotation.T, origin - to_level @ rotation.T @ shift, geometry.mount_height),
    )
