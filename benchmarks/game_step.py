"""How many whole game steps a second one core makes, state images of both robots included.

A step: both motions, both 1 x 128 RGB-D pictures with noise, both column scans, both sightings of the other robot, both
state images, the catch test. Both robots wander; a caught hider or 100 steps start a new game with new boxes, which is
part of the time. `python benchmarks/game_step.py --help` shows the settings.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import plain_game
import tyro

from vantage.compiled import kernel
from vantage.perception.state_image import look
from vantage.world.arena import ARENA_SIZE, BACKWARD, CATCH_DISTANCE, FORWARD, HIDER, LEFT, RIGHT, SEEKER
from vantage.world.camera import Camera, directions
from vantage.world.game import step_game
from vantage.world.layout import draw_boxes
from vantage.world.noise import uniform
from vantage.world.rays import cast_row
from vantage.world.start import try_start

Floats = npt.NDArray[np.float64]

BENCHMARK_STREAM = 90
GAME_STEPS = 100

PEERS = (
    ("navground 0.7 (poses set from outside, lidar)", 32_360),
    ("MuJoCo 4.0, 5 substeps + mj_multiRay", 19_026),
    ("VMAS 1.5.2, 4,096 environments", 11_764),
    ("irsim-x 1.1.4 (C++)", 6_827),
    ("ir-sim 2.12", 1_880),
    ("pybullet rayTestBatch", 1_530),
)
"""Environment steps a second with two agents, 128 rays each over 86 degrees, six boxes, four walls; 2 shared cores, Python
3.11, measured beforehand with the versions named. None of them makes state images."""


@dataclass
class Settings:
    """What is measured."""

    steps: int = 100_000
    """game steps a repetition"""
    repetitions: int = 5
    plain_steps: int = 300
    """steps of the plain numpy implementation"""
    seed: int = 1


@kernel
def new_game(seed: int, game: int, boxes: Floats, poses: Floats) -> None:
    """Draw both poses (float64 [2, 3]) of one game, and its boxes (float64 [n, 7]) if it has three."""
    number = seed * 1_000_003 + game
    if boxes.shape[0] == 3:
        draw_boxes(number, ARENA_SIZE, ARENA_SIZE, boxes, np.empty(3))
    _, poses[0, 0], poses[0, 1], poses[0, 2], poses[1, 0], poses[1, 1], poses[1, 2] = try_start(
        boxes, ARENA_SIZE, ARENA_SIZE, number, 0.25, 0.45
    )


@kernel
def wander(seed: int, step: int, moved: npt.NDArray[np.bool_], primitives_out: npt.NDArray[np.int64]) -> None:
    """Mostly forward, some turns, a turn after every refusal."""
    for robot in range(2):
        draw = uniform(seed, BENCHMARK_STREAM, step, robot)
        if not moved[robot] or draw < 0.15:
            primitives_out[robot] = LEFT
        elif draw < 0.30:
            primitives_out[robot] = RIGHT
        elif draw < 0.35:
            primitives_out[robot] = BACKWARD
        else:
            primitives_out[robot] = FORWARD


@kernel
def play(
    steps: int,
    seed: int,
    images: bool,
    boxes: Floats,
    rightward: Floats,
    downward: Floats,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    mount_height: float,
    images_out: npt.NDArray[np.uint8],
) -> tuple[int, int]:
    """Play so many steps; returns games begun and how often a robot was in sight (so that no work can be left out)."""
    poses = np.empty((2, 3))
    primitives = np.empty(2, np.int64)
    moved = np.ones(2, np.bool_)
    columns = rightward.shape[0]
    depths = np.empty((2, 1, columns), np.uint16)
    colors = np.empty((2, 1, columns, 3), np.uint8)
    ranges = np.empty((2, columns))
    kinds = np.empty((2, columns), np.uint8)
    games = 0
    sightings = 0
    age = GAME_STEPS
    for step in range(steps):
        if age == GAME_STEPS:
            new_game(seed, games, boxes, poses)
            games += 1
            age = 0
        age += 1
        wander(seed, step, moved, primitives)
        caught = step_game(
            rightward,
            downward,
            mount_height,
            True,
            boxes,
            ARENA_SIZE,
            ARENA_SIZE,
            poses,
            primitives,
            CATCH_DISTANCE,
            seed,
            step,
            poses,
            moved,
            depths,
            colors,
        )
        for robot in range(2):
            angle = poses[robot, 2] * (np.pi / 18.0)
            seen, _, _, _ = look(
                depths[robot],
                colors[robot],
                fx,
                fy,
                cx,
                cy,
                mount_height,
                1 - robot,
                poses[robot, 0],
                poses[robot, 1],
                angle,
                ranges[robot],
                kinds[robot],
                images,
                images_out[robot],
            )
            sightings += seen >= 2
        if caught:
            age = GAME_STEPS
    return games, sightings


def six_boxes() -> Floats:
    """The peers' number of boxes, float64 [6, 7]: two rows of three, standing askew."""
    rows = [(0.25 + 0.35 * (i % 3), 0.4 + 0.4 * (i // 3), 0.06, 0.05, np.cos(i), np.sin(i), 0.2) for i in range(6)]
    return np.array(rows)


def compiled_rates(settings: Settings, images: bool, boxes: Floats) -> tuple[Floats, Floats]:
    """Steps a second of each repetition: by the wall clock, and by the CPU time the process was given."""
    camera = Camera()
    pinhole = camera.intrinsics()
    pictures = np.zeros((2, 128, 128), np.uint8)
    lens = (*directions(camera), pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy, camera.mount_height, pictures)
    play(100, settings.seed, images, boxes, *lens)
    elapsed = np.empty((2, settings.repetitions))
    for repetition in range(settings.repetitions):
        wall, processor = time.perf_counter(), time.process_time()
        play(settings.steps, settings.seed + repetition, images, boxes, *lens)
        elapsed[:, repetition] = time.perf_counter() - wall, time.process_time() - processor
    return settings.steps / elapsed[0], settings.steps / elapsed[1]


def plain_rates(settings: Settings) -> tuple[float, float]:
    """Steps a second of the plain implementation, on the same games: by the wall clock, and by CPU time."""
    random = np.random.default_rng(settings.seed)
    boxes, poses = np.empty((3, 7)), np.empty((2, 3))
    moved, primitives = np.ones(2, np.bool_), np.empty(2, np.int64)
    wall, processor = time.perf_counter(), time.process_time()
    caught, games = True, 0
    for step in range(settings.plain_steps):
        if caught or step % GAME_STEPS == 0:
            new_game(settings.seed, games, boxes, poses)
            games += 1
        wander(settings.seed, step, moved, primitives)
        after, _, caught = plain_game.step(boxes, poses, primitives, random)
        moved = (after != poses).any(axis=1)
        poses = after
    return settings.plain_steps / (time.perf_counter() - wall), settings.plain_steps / (time.process_time() - processor)


def greatest_difference(settings: Settings) -> float:
    """Greatest difference in depth between the kernel and the plain implementation over 100 views, m."""
    boxes, poses = np.empty((3, 7)), np.empty((2, 3))
    camera = Camera()
    rightward, _ = directions(camera)
    depths, surfaces = np.empty(camera.width), np.empty(camera.width, np.int64)
    worst = 0.0
    for game in range(100):
        new_game(settings.seed, game, boxes, poses)
        cast_row(
            rightward,
            camera.mount_height,
            boxes,
            ARENA_SIZE,
            ARENA_SIZE,
            poses[HIDER, 0],
            poses[HIDER, 1],
            poses[HIDER, 2] * (np.pi / 18.0),
            poses[SEEKER, 0],
            poses[SEEKER, 1],
            SEEKER,
            depths,
            surfaces,
        )
        expected, _ = plain_game.cast(boxes, poses[HIDER], poses[SEEKER], SEEKER)
        worst = max(worst, float(np.abs(expected - depths).max()))
    return worst


def line(name: str, wall: Floats, processor: Floats) -> None:
    """Print one measurement."""
    print(f"  {name:<32}{np.median(wall):>9,.0f}{wall.min():>9,.0f}{wall.max():>9,.0f}{np.median(processor):>11,.0f}")


def main(settings: Settings) -> None:
    """Measure and print."""
    whole = compiled_rates(settings, images=True, boxes=np.empty((3, 7)))
    bare = compiled_rates(settings, images=False, boxes=np.empty((3, 7)))
    six = compiled_rates(settings, images=False, boxes=six_boxes())
    plain_wall, plain_processor = plain_rates(settings)
    print(f"whole game steps a second, one core, {settings.repetitions} x {settings.steps:,} steps")
    print(f"  {'':<32}{'median':>9}{'worst':>9}{'best':>9}{'by CPU time':>14}")
    line("compiled, both state images", *whole)
    line("compiled, scans only", *bare)
    line("compiled, scans only, six boxes", *six)
    line("plain numpy, both state images", np.array([plain_wall]), np.array([plain_processor]))
    print(f"compiled is {np.median(whole[1]) / plain_processor:,.0f} times as fast as plain numpy, by CPU time")
    print(f"depth of the two implementations differs by {greatest_difference(settings):.1e} m at most")
    print("peers, measured beforehand: six boxes, no state images (factor: our six boxes over theirs, wall clock)")
    for name, rate in PEERS:
        print(f"  {name:<46}{rate:>8,}   ({np.median(six[0]) / rate:.1f})")


if __name__ == "__main__":
    main(tyro.cli(Settings))
