"""The state image from rendered, noisy RGB-D pictures against the ideal one; and how long preparing a picture takes.

    python benchmarks/rgbd_state_image.py [--scenes 300] [--empty 1000] [--seed 1]

Each scene: a random layout, one robot anywhere free (continuous pose), the other anywhere free, in view or not. The ideal
state image comes from the exact camera of `vantage.world.camera` (level, no noise, the published size) at the same pose, the
measured one from `render_rgbd` (two lenses, tilted, 640 x 480, noise, drop-outs, holes, uneven light) through `RgbdPreparer`.
Compared is the visible-free area (palette index FREE). Half visible: of the columns that the other robot's disc spans in the
exact camera's picture plane, whether inside the picture or not, at least half show it in the exact camera's picture.
Goals: IoU 0.95 on average; the other robot found wherever at least half of it is visible; never found in 1,000 views without it;
at most 5 ms a picture.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace

import msgspec
import numpy as np
import tyro
from numpy.typing import NDArray

from schemas import ColorImage, DepthImage, Intrinsics, Pose
from vantage.perception.palette import FREE
from vantage.perception.scan import ROBOT
from vantage.perception.state_image import Perceived, perceive
from vantage.rehearsal.rgbd_picture import RgbdCamera, RgbdLook, render_rgbd
from vantage.tracking.colors import correct_colors, measure_rectangle
from vantage.tracking.rgbd import RgbdCalibration, RgbdPreparer, default_rgbd
from vantage.tracking.rgbd_lens import Lens, lens_of
from vantage.world.arena import ARENA_SIZE, HIDER_COLOR, ROBOT_RADIUS, SEEKER_COLOR, WALL_COLOR
from vantage.world.camera import Camera, render
from vantage.world.layout import boxes_array, make_layout
from vantage.world.motion import is_free

Floats = NDArray[np.float64]
Place = tuple[float, float]


@dataclass(frozen=True)
class Scene:
    """A view: the robot `viewer` (0 hider, 1 seeker) at `pose`, the other at `other`."""

    boxes: Floats
    pose: tuple[float, float, float]
    other: Place | None
    viewer: int
    seed: int


def draw_scene(seed: int, with_other: bool = True) -> Scene:
    """The scene of a seed; in three of four the viewer looks more or less towards the other robot."""
    generator = np.random.default_rng(seed)
    boxes = boxes_array(make_layout("random", seed))

    def free_place() -> Place:
        while True:
            x, y = map(float, generator.uniform(ROBOT_RADIUS, ARENA_SIZE - ROBOT_RADIUS, 2))
            if is_free(boxes, ARENA_SIZE, ARENA_SIZE, x, y, ROBOT_RADIUS):
                return x, y

    x, y = free_place()
    other = free_place()
    while math.hypot(other[0] - x, other[1] - y) < 2.0 * ROBOT_RADIUS + 0.005:
        other = free_place()
    heading = math.atan2(other[1] - y, other[0] - x) + generator.uniform(-0.9, 0.9)
    if generator.random() < 0.25:
        heading = generator.uniform(-math.pi, math.pi)
    heading = math.atan2(math.sin(heading), math.cos(heading))
    return Scene(boxes, (x, y, heading), other if with_other else None, seed % 2, seed)


def see(depth: NDArray[np.uint16], color: NDArray[np.uint8], intrinsics: Intrinsics, scene: Scene, viewer: int) -> Perceived:
    """Through the messages, as the planner and the seeker do."""
    height, width = depth.shape
    x, y, heading = scene.pose
    return perceive(
        DepthImage(stamp=0, width=width, height=height, intrinsics=intrinsics, data=depth.tobytes()),
        ColorImage(stamp=0, width=width, height=height, intrinsics=intrinsics, data=color.tobytes()),
        Pose(stamp=0, x=x, y=y, heading=heading),
        "seeker" if viewer else "hider",
    )


def exact_view(scene: Scene, width: int, height: int) -> Perceived:
    """What the exact camera's picture shows."""
    camera = Camera(width=width, height=height, noise=False)
    depth = np.empty((height, width), np.uint16)
    color = np.empty((height, width, 3), np.uint8)
    other = (math.nan, math.nan) if scene.other is None else scene.other
    render(camera, scene.boxes, ARENA_SIZE, ARENA_SIZE, *scene.pose, *other, 1 - scene.viewer, 0, 0, 0, depth, color)
    return see(depth, color, camera.intrinsics(), scene, scene.viewer)


def visible_share(scene: Scene, exact: Perceived) -> float:
    """Columns of the exact camera that show the other robot, of those that its disc spans in the picture plane (0..1)."""
    if scene.other is None:
        return 0.0
    x, y, heading = scene.pose
    distance = math.hypot(scene.other[0] - x, scene.other[1] - y)
    bearing = math.atan2(scene.other[1] - y, scene.other[0] - x) - heading
    bearing = math.atan2(math.sin(bearing), math.cos(bearing))
    half = math.asin(ROBOT_RADIUS / distance)
    ends = [math.tan(min(max(bearing + side * half, -1.5), 1.5)) for side in (-1.0, 1.0)]
    return float(np.sum(exact.kinds == ROBOT)) / max(1.0, exact.camera.fx * (ends[1] - ends[0]))


def prepared_view(scene: Scene, camera: RgbdCamera, preparer: RgbdPreparer, viewer: int | None = None) -> Perceived:
    """What the rendered camera shows after `prepare`; `viewer` looks for the other's colour, whoever rendered it."""
    depth, color = render_rgbd(
        camera, scene.boxes, scene.pose, scene.other, 1 - scene.viewer, scene.seed, 0, scene.viewer, ARENA_SIZE, ARENA_SIZE
    )
    return see(*preparer.prepare(depth, color), scene, scene.viewer if viewer is None else viewer)


def overlap(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Intersection over union of the visible-free areas of two state images."""
    both, either = np.sum((a == FREE) & (b == FREE)), np.sum((a == FREE) | (b == FREE))
    return float(both / either) if either else 1.0


@dataclass
class Figures:
    """What came of a set of scenes."""

    overlaps: list[float]
    half_visible: int = 0
    found: int = 0
    missed: list[int] | None = None
    place_errors: list[float] | None = None

    def interval(self) -> tuple[float, float]:
        """95 % bootstrap interval of the mean overlap."""
        values = np.array(self.overlaps)
        draws = np.random.default_rng(0).integers(0, len(values), (2000, len(values)))
        low, high = np.percentile(values[draws].mean(axis=1), [2.5, 97.5])
        return float(low), float(high)


def compare(seeds: Iterable[int], camera: RgbdCamera, preparer: RgbdPreparer) -> Figures:
    """Compare prepared and exact views of scenes."""
    figures = Figures([], missed=[], place_errors=[])
    assert figures.missed is not None and figures.place_errors is not None
    height, width = preparer.shape
    for seed in seeds:
        scene = draw_scene(seed)
        exact = exact_view(scene, width, height)
        seen = prepared_view(scene, camera, preparer)
        figures.overlaps.append(overlap(seen.image, exact.image))
        if visible_share(scene, exact) >= 0.5:
            figures.half_visible += 1
            if seen.other is None:
                figures.missed.append(seed)
            else:
                figures.found += 1
                assert scene.other is not None
                figures.place_errors.append(1000.0 * math.dist(seen.other, scene.other))
    return figures


def false_findings(seeds: Iterable[int], camera: RgbdCamera, preparer: RgbdPreparer) -> int:
    """Views without another robot in which either robot's colour is found."""
    count = 0
    for seed in seeds:
        scene = draw_scene(seed, with_other=False)
        count += any(prepared_view(scene, camera, preparer, viewer).other is not None for viewer in (0, 1))
    return count


def _card(camera: RgbdCamera, color: tuple[int, int, int]) -> NDArray[np.uint8]:
    """A card of one colour, as the camera of these looks sees it."""
    look = camera.look
    gains = look.brightness * np.array([look.red_gain, look.green_gain, look.blue_gain])
    noise = np.random.default_rng(sum(color)).normal(0.0, 3.0, (40, 40, 3))
    return np.clip(np.array(color) * gains + noise + 0.5, 0, 255).astype(np.uint8)


def corrected(camera: RgbdCamera) -> RgbdCalibration:
    """The camera's calibration with its colours corrected from cards of the three surfaces."""
    patches = [measure_rectangle(_card(camera, color), 0, 0, 40, 40) for color in (HIDER_COLOR, SEEKER_COLOR, WALL_COLOR)]
    return msgspec.structs.replace(camera.geometry, correction=correct_colors(*patches)[0])


@dataclass(frozen=True)
class Settings:
    """Compare prepared RGB-D with the ideal camera."""

    scenes: int = 300
    """Scenes of the main row; the variants take a third."""
    empty: int = 1000
    """Views without the other robot."""
    seed: int = 1
    """First seed; scene n has seed + n, empty view n has seed + 1,000,000 + n."""
    variants: bool = True
    """Also other mounts, lenses and lights."""


def variants() -> dict[str, tuple[RgbdCamera, RgbdCalibration]]:
    """Name -> (the camera as it is, what is believed of it)."""
    geometry = default_rgbd()

    def with_geometry(**changes: object) -> tuple[RgbdCamera, RgbdCalibration]:
        changed = msgspec.structs.replace(geometry, **changes)
        return RgbdCamera(changed), changed

    def with_light(**changes: float) -> tuple[RgbdCamera, RgbdCalibration]:
        camera = RgbdCamera(geometry, replace(RgbdLook(), **changes))
        return camera, corrected(camera)

    def misjudged(**changes: object) -> tuple[RgbdCamera, RgbdCalibration]:
        return RgbdCamera(msgspec.structs.replace(geometry, **changes)), geometry

    def bent(lens: Lens) -> Lens:
        return msgspec.structs.replace(lens, distortion=(-0.05, 0.01, 0.0005, -0.0005, 0.0))

    return {
        "no noise, holes or drop-outs": (
            RgbdCamera(geometry, RgbdLook(noise=0.0, edge_drop_out=0.0, flying=0.0, holes=0.0, unevenness=0.0)),
            geometry,
        ),
        "level": with_geometry(tilt=0.0),
        "tilt 10 degrees": with_geometry(tilt=math.radians(10.0)),
        "20 mm ahead of the centre": with_geometry(forward=0.02),
        "lenses 25 mm apart": with_geometry(translation=(-0.025, 0.0, 0.0)),
        "colour lens 69 degrees wide": with_geometry(color=lens_of(640, 480, math.radians(69.0))),
        "distorted lenses": with_geometry(depth=bent(geometry.depth), color=bent(geometry.color)),
        "noise doubled": (RgbdCamera(geometry, RgbdLook(noise=2.0)), geometry),
        "5 % holes": (RgbdCamera(geometry, RgbdLook(holes=0.05)), geometry),
        "stereo shadow of 50 mm": (RgbdCamera(geometry, RgbdLook(stereo_baseline=0.05)), geometry),
        "warm dim light, corrected": with_light(red_gain=1.05, green_gain=0.9, blue_gain=0.6, brightness=0.6),
        "cold bright light, corrected": with_light(red_gain=0.7, green_gain=0.9, blue_gain=1.1, brightness=1.1),
        "tilt misjudged by 0.5 degrees": misjudged(tilt=geometry.tilt + math.radians(0.5)),
        "height misjudged by 3 mm": misjudged(mount_height=geometry.mount_height + 0.003),
    }


def row(name: str, figures: Figures) -> str:
    values = np.array(figures.overlaps)
    low, high = figures.interval()
    place = np.median(figures.place_errors) if figures.place_errors else math.nan
    return (
        f"{name:32} {len(values):5d} {values.mean():7.4f} [{low:.4f}, {high:.4f}] {np.percentile(values, 5):7.4f} "
        f"{figures.found:5d}/{figures.half_visible:<5d} {place:6.1f}  {figures.missed or ''}"
    )


def times(preparer: RgbdPreparer, camera: RgbdCamera, seeds: Iterable[int]) -> dict[str, NDArray[np.float64]]:
    """ms of rendering and of preparing each pair of pictures: [n, 2], on the clock and of this thread's own processor time."""
    taken: dict[str, list[tuple[float, float]]] = {"render_rgbd": [], "prepare": []}
    for seed in seeds:
        scene = draw_scene(seed)
        started = time.perf_counter(), time.thread_time()
        depth, color = render_rgbd(camera, scene.boxes, scene.pose, scene.other, 1 - scene.viewer, seed, 0, scene.viewer)
        between = time.perf_counter(), time.thread_time()
        preparer.prepare(depth, color)
        ended = time.perf_counter(), time.thread_time()
        taken["render_rgbd"].append((between[0] - started[0], between[1] - started[1]))
        taken["prepare"].append((ended[0] - between[0], ended[1] - between[1]))
    return {name: 1000.0 * np.array(values[1:]) for name, values in taken.items()}


def main(settings: Settings) -> None:
    seeds = range(settings.seed, settings.seed + settings.scenes)
    camera = RgbdCamera()
    preparer = RgbdPreparer(camera.geometry)
    print(f"{'camera':32} {'n':>5} {'IoU':>7} {'95 % interval':16} {'5th %':>7} {'found/half visible':>11} {'mm off (median)'}")
    print(row("rehearsal's camera", compare(seeds, camera, preparer)), flush=True)
    empty = range(settings.seed + 1_000_000, settings.seed + 1_000_000 + settings.empty)
    print(
        f"views without the other robot in which either robot is found: {false_findings(empty, camera, preparer)} of {len(empty)}"
    )
    for name, taken in times(preparer, camera, range(settings.seed, settings.seed + 101)).items():
        wall, own = np.percentile(taken, [50, 95], axis=0).T
        print(
            f"{name:12} 640 x 480: median {wall[0]:6.2f} ms, 95th percentile {wall[1]:6.2f} ms on the clock; "
            f"{own[0]:6.2f} and {own[1]:6.2f} ms of processor time",
            flush=True,
        )
    if settings.variants:
        for name, (variant, believed) in variants().items():
            print(row(name, compare(seeds[: max(1, len(seeds) // 3)], variant, RgbdPreparer(believed))), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Settings))
