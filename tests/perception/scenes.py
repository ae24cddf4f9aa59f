"""Scenes for the perception tests: random games on random layouts, and what an ideal observer would see of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from schemas import ColorImage, DepthImage, Pose
from vantage.perception.palette import PIXEL_SIZE
from vantage.perception.state_image import Perceived, perceive
from vantage.world.arena import ARENA_SIZE, ROBOT_RADIUS
from vantage.world.camera import Camera, render
from vantage.world.layout import boxes_array, make_layout
from vantage.world.motion import is_free

NARROW = Camera()
MEDIUM = Camera(width=160, height=120)
WIDE = Camera(width=640, height=480)


@dataclass(frozen=True)
class Scene:
    """One robot at a pose, the other somewhere (NaN: nowhere)."""

    boxes: NDArray[np.float64]  # [n, 7]
    x: float
    y: float
    heading: float
    other_x: float
    other_y: float
    seed: int

    def without_other(self) -> Scene:
        return replace(self, other_x=math.nan, other_y=math.nan)

    def messages(self, camera: Camera) -> tuple[DepthImage, ColorImage, Pose]:
        depth = np.zeros((camera.height, camera.width), np.uint16)
        color = np.zeros((camera.height, camera.width, 3), np.uint8)
        render(
            camera,
            self.boxes,
            1.2,
            1.2,
            self.x,
            self.y,
            self.heading,
            self.other_x,
            self.other_y,
            1,
            self.seed,
            0,
            0,
            depth,
            color,
        )
        picture = {"stamp": 0, "width": camera.width, "height": camera.height, "intrinsics": camera.intrinsics()}
        return (
            DepthImage(data=depth.tobytes(), **picture),
            ColorImage(data=color.tobytes(), **picture),
            Pose(stamp=0, x=self.x, y=self.y, heading=self.heading),
        )

    def seen_by(self, camera: Camera, draw: bool = True) -> Perceived:
        """The hider's view."""
        return perceive(*self.messages(camera), "hider", draw=draw)


def random_scene(seed: int) -> Scene:
    """A random layout, one robot anywhere free, the other somewhere free in front of it or hidden."""
    generator = np.random.default_rng(seed)
    boxes = boxes_array(make_layout("random", seed))

    def free_place() -> tuple[float, float]:
        while True:
            x, y = generator.uniform(0.07, 1.13, 2)
            if is_free(boxes, 1.2, 1.2, x, y, ROBOT_RADIUS):
                return float(x), float(y)

    x, y = free_place()
    other_x, other_y = free_place()
    while math.hypot(other_x - x, other_y - y) < 0.15:
        other_x, other_y = free_place()
    heading = math.atan2(other_y - y, other_x - x) + generator.uniform(-0.8, 0.8)
    return Scene(boxes, x, y, math.atan2(math.sin(heading), math.cos(heading)), other_x, other_y, seed)


def pixel_centers() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """x and y of every pixel's centre, [128, 128] each, m."""
    along = (np.arange(128) + 0.5) * PIXEL_SIZE
    x, y = np.meshgrid(along, ARENA_SIZE - along)
    return x, y


def _box_hits(scene: Scene, to_x: NDArray[np.float64], to_y: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether the straight line from the robot to each point meets a box."""
    hits = np.zeros(to_x.shape, bool)
    for x, y, half_width, half_depth, cosine, sine, _ in scene.boxes:
        start = np.array([(scene.x - x) * cosine + (scene.y - y) * sine, (scene.y - y) * cosine - (scene.x - x) * sine])
        enter = np.zeros(to_x.shape)
        leave = np.ones(to_x.shape)
        for axis, half in ((0, half_width), (1, half_depth)):
            end = (to_x - x) * cosine + (to_y - y) * sine if axis == 0 else (to_y - y) * cosine - (to_x - x) * sine
            step = end - start[axis]
            step = np.where(step == 0.0, 1e-300, step)
            a = (-half - start[axis]) / step
            b = (half - start[axis]) / step
            enter = np.maximum(enter, np.minimum(a, b))
            leave = np.minimum(leave, np.maximum(a, b))
        hits |= enter <= leave
    return hits


def _distance_to_line(scene: Scene, to_x: NDArray[np.float64], to_y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of the other robot's centre from the line between the robot and each point."""
    step_x, step_y = to_x - scene.x, to_y - scene.y
    length = step_x**2 + step_y**2 + 1e-300
    part = np.clip(((scene.other_x - scene.x) * step_x + (scene.other_y - scene.y) * step_y) / length, 0.0, 1.0)
    return np.hypot(scene.x + part * step_x - scene.other_x, scene.y + part * step_y - scene.other_y)


def ideally_visible(scene: Scene, camera: Camera = NARROW) -> NDArray[np.bool_]:
    """Every pixel whose centre a ray from the robot reaches unhindered within the field of view, by brute force. [128, 128]"""
    x, y = pixel_centers()
    bearing = np.arctan2(y - scene.y, x - scene.x) - scene.heading
    bearing = np.arctan2(np.sin(bearing), np.cos(bearing))
    visible = (np.abs(bearing) <= camera.horizontal_fov / 2) & ~_box_hits(scene, x, y)
    if not math.isnan(scene.other_x):
        visible &= _distance_to_line(scene, x, y) > ROBOT_RADIUS
    return visible


def disc(x: float, y: float) -> NDArray[np.bool_]:
    """Pixels whose centre lies within a robot's radius of (x, y). [128, 128]"""
    pixel_x, pixel_y = pixel_centers()
    return np.hypot(pixel_x - x, pixel_y - y) <= ROBOT_RADIUS


def visible_share(scene: Scene, camera: Camera = NARROW) -> float:
    """The part of the other robot's angular width that is in view and that no box hides (0..1), by 401 rays."""
    distance = math.hypot(scene.other_x - scene.x, scene.other_y - scene.y)
    middle = math.atan2(scene.other_y - scene.y, scene.other_x - scene.x)
    half = math.asin(ROBOT_RADIUS / distance)
    angle = np.linspace(-half, half, 401)
    # The front of the disc along each ray.
    reach = distance * np.cos(angle) - np.sqrt(np.maximum(0.0, ROBOT_RADIUS**2 - (distance * np.sin(angle)) ** 2))
    bearing = np.arctan2(np.sin(middle + angle - scene.heading), np.cos(middle + angle - scene.heading))
    in_view = np.abs(bearing) <= camera.horizontal_fov / 2
    to_x, to_y = scene.x + reach * np.cos(middle + angle), scene.y + reach * np.sin(middle + angle)
    return float(np.mean(in_view & ~_box_hits(scene, to_x, to_y)))


def overlap(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    """Intersection over union."""
    return float(np.sum(a & b) / max(1, np.sum(a | b)))
