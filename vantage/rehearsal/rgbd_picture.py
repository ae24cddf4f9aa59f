"""What an RGB-D camera on a robot gives: two lenses apart, tilted, with the noise, holes and light of a real table."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from vantage.tracking.rgbd import RgbdCalibration, default_rgbd

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
    holes: float = 0.01
    """share of the depth picture in blotches without return"""
    red_gain: float = 1.0
    green_gain: float = 1.0
    blue_gain: float = 1.0
    brightness: float = 1.0
    unevenness: float = 0.15
    """by which the light falls off from one side of the table to the other, share"""


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
    raise NotImplementedError
