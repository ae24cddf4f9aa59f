"""How exactly and how fast the overhead tracker follows two robots: against the truth, and against searching whole frames.

Two robots carry out random primitives on random layouts (a start and a stop in each primitive); the overhead camera's pictures
are rendered with perspective, lens distortion, blur, motion blur, uneven light and noise. Accuracy: every tracked pose against
the true one at the stamp. Speed: the same frames, from memory, through the tracker and through pupil-apriltags on the whole
frame at the same decimation, alternating in blocks, one thread. `python benchmarks/overhead_tracker.py --help` shows the
settings.
"""

from __future__ import annotations

import datetime
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt
import tyro

from schemas import Box
from vantage.rehearsal.overhead_light import OverheadLook
from vantage.rehearsal.overhead_picture import ROBOTS, OverheadScene, rehearsal_camera, table_of_layout
from vantage.tracking.calibration import Calibration, Lens, calibrate_arena
from vantage.tracking.overhead import Observation, OverheadTracker
from vantage.tracking.table import Table, default_table
from vantage.tracking.tag_pose import wrapped
from vantage.tracking.tags import TagFinder
from vantage.world.arena import ARENA_SIZE, BACKWARD, FORWARD, LEFT, RIGHT, STAY, TURN
from vantage.world.game import move_both
from vantage.world.layout import boxes_array, make_layout
from vantage.world.start import draw_start

Floats = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

SECOND = 1_000_000_000
RESAMPLES = 2_000


@dataclass
class Settings:
    """What is measured."""

    seeds: tuple[int, ...] = (1, 2, 3, 4, 5)
    """layouts, starts, motions and noise"""
    frames: int = 400
    """of each seed"""
    rate: float = 30.0
    """frames a second"""
    primitive_time: float = 0.25
    """s a primitive takes"""
    timed_frames: int = 240
    """kept in memory for the speed, 2.8 MB each"""
    rounds: int = 3
    """times that the kept frames are run through both sides"""
    light: OverheadLook = field(default_factory=OverheadLook)


@dataclass(frozen=True)
class Take:
    """One picture and what is true in it: robots float64 [2, 3], speeds float64 [2, 3]."""

    stamp: int
    robots: Floats
    speeds: Floats


def motion(settings: Settings, seed: int, boxes: tuple[Box, ...]) -> Iterator[Take]:
    """Robots on random primitives, each begun and ended at rest; without end."""
    random = np.random.default_rng(seed)
    solids = boxes_array(boxes)
    poses = np.array(draw_start(solids, ARENA_SIZE, ARENA_SIZE, seed, 0.25, 0.45), dtype=np.float64)
    moved = np.ones(2, np.bool_)
    turns = poses[:, 2].copy()  # in steps of 10 degrees, not wrapped
    step, frame = 0, 0
    target, target_turns, last = poses.copy(), turns.copy(), poses.copy()
    while True:
        passed = frame / settings.rate
        while step * settings.primitive_time <= passed:
            last, turns = target, target_turns
            primitives = random.choice((FORWARD, BACKWARD, LEFT, RIGHT, STAY), 2, p=(0.5, 0.1, 0.17, 0.17, 0.06))
            target = np.empty((2, 3))
            move_both(solids, ARENA_SIZE, ARENA_SIZE, last, primitives.astype(np.int64), target, moved)
            change = (target[:, 2] - last[:, 2] + 18) % 36 - 18
            target_turns = turns + change
            step += 1
        share = passed / settings.primitive_time - (step - 1)
        way, slope = share * share * (3 - 2 * share), 6 * share * (1 - share) / settings.primitive_time
        start = np.column_stack((last[:, :2], turns * TURN))
        end = np.column_stack((target[:, :2], target_turns * TURN))
        yield Take(round((1.0 + passed) * SECOND), start + way * (end - start), slope * (end - start))
        frame += 1


def calibrated(scene: OverheadScene, truth: Calibration, table: Table) -> Calibration:
    """Calibrate as a lab does: from one picture of the empty table (the lens is known)."""
    lens = Lens(width=truth.width, height=truth.height, matrix=truth.matrix, distortion=truth.distortion, residual=0.0)
    picture = scene.render(np.full((2, 3), np.nan), (), 0, 0)
    return calibrate_arena(picture, table, lens, datetime.date(2000, 1, 1))


def scene_of(settings: Settings, seed: int) -> tuple[OverheadScene, OverheadTracker, tuple[Box, ...]]:
    """The rendered table of a seed, a tracker calibrated on it, and its boxes."""
    boxes = make_layout("random", seed)
    table = table_of_layout(default_table(), boxes)
    truth = rehearsal_camera()
    scene = OverheadScene(table, truth, settings.light)
    return scene, OverheadTracker(table, calibrated(scene, truth, table)), boxes


@dataclass(frozen=True)
class Accuracy:
    """Errors of every frame and robot, NaN where it was not seen: place in mm and heading in degrees, float64 [n, 2]."""

    place: Floats
    heading: Floats
    render: float
    box_place: float
    box_heading: float
    troubles: tuple[str, ...]


def accuracy_of(settings: Settings, seed: int) -> Accuracy:
    """Follow one seed's robots and compare with the truth."""
    scene, tracker, boxes = scene_of(settings, seed)
    place, heading = np.full((settings.frames, 2), np.nan), np.full((settings.frames, 2), np.nan)
    rendering, troubles = 0.0, set()
    observed: Observation | None = None
    for frame, take in zip(range(settings.frames), motion(settings, seed, boxes), strict=False):
        begun = time.process_time()
        picture = scene.render(take.robots, boxes, seed, frame, take.speeds)
        rendering += time.process_time() - begun
        observed = tracker.observe(picture, take.stamp)
        troubles.update(observed.troubles)
        for index, robot in enumerate(ROBOTS):
            track = observed.tracks[robot]
            if track is not None and track.seen:
                x, y, angle = take.robots[index]
                place[frame, index] = 1000 * np.hypot(track.x - x, track.y - y)
                heading[frame, index] = np.degrees(wrapped(track.heading - angle))
    assert observed is not None and len(observed.boxes) == len(boxes), "boxes were not found"
    pairs = list(zip(observed.boxes, boxes, strict=True))
    box_place = max(1000 * float(np.hypot(found.x - box.x, found.y - box.y)) for found, box in pairs)
    box_heading = max(abs(float(np.degrees(wrapped(found.heading - box.heading)))) for found, box in pairs)
    return Accuracy(place, heading, rendering / settings.frames, box_place, box_heading, tuple(sorted(troubles)))


def root_mean_square(values: Floats) -> float:
    """Over what was seen."""
    return float(np.sqrt(np.nanmean(values**2)))


def interval(values: Floats, rate: float) -> tuple[float, float]:
    """95 % interval of the root mean square: bootstrap over blocks of one second (frames in a row are alike)."""
    size = max(1, round(rate))
    blocks = [values[start : start + size] for start in range(0, len(values), size)]
    random = np.random.default_rng(0)
    drawn = [
        root_mean_square(np.concatenate([blocks[i] for i in random.integers(0, len(blocks), len(blocks))]))
        for _ in range(RESAMPLES)
    ]
    return float(np.percentile(drawn, 2.5)), float(np.percentile(drawn, 97.5))


@dataclass(frozen=True)
class Speed:
    """Seconds of every frame, float64 [n], by the wall clock and by CPU time."""

    tracker: Floats
    tracker_processor: Floats
    whole: Floats
    whole_processor: Floats


def speed_of(settings: Settings) -> Speed:
    """Run the same frames through both sides, alternating in blocks of a second."""
    seed = settings.seeds[0]
    scene, tracker, boxes = scene_of(settings, seed)
    takes = [take for _, take in zip(range(settings.timed_frames), motion(settings, seed, boxes), strict=False)]
    pictures = [scene.render(take.robots, boxes, seed, frame, take.speeds) for frame, take in enumerate(takes)]
    finder = TagFinder()
    whole_window = (0, 0, tracker.calibration.width, tracker.calibration.height)
    wanted = {tag.id for tag in tracker.table.robots.values()}
    results: list[list[float]] = [[], [], [], []]
    for take, picture in zip(takes[:30], pictures, strict=False):  # warm up
        tracker.observe(picture, take.stamp)
        finder.find(picture, whole_window, True)
    for turn in range(settings.rounds):
        # Time goes on from round to round: the robots jump, which is part of the cost.
        offset = (turn + 1) * round(settings.timed_frames / settings.rate * SECOND)
        for start in range(0, len(takes), 30):
            for index in range(start, min(start + 30, len(takes))):
                wall, processor = time.perf_counter(), time.process_time()
                observed = tracker.observe(pictures[index], takes[index].stamp + offset)
                results[0].append(time.perf_counter() - wall)
                results[1].append(time.process_time() - processor)
                assert all(observed.tracks.values())
            for index in range(start, min(start + 30, len(takes))):
                wall, processor = time.perf_counter(), time.process_time()
                found = finder.find(pictures[index], whole_window, True)
                results[2].append(time.perf_counter() - wall)
                results[3].append(time.process_time() - processor)
                assert wanted <= {tag.id for tag in found}
    return Speed(*(np.array(values) for values in results))


def main(settings: Settings) -> None:
    """Measure and print."""
    cv2.setNumThreads(1)
    parts = [accuracy_of(settings, seed) for seed in settings.seeds]
    place, heading = np.concatenate([p.place for p in parts]), np.concatenate([p.heading for p in parts])
    seen = np.isfinite(place)
    print(f"accuracy: {place.shape[0]:,} frames of 1280 x 720 with two robots, seeds {', '.join(map(str, settings.seeds))}")
    for name, values, unit in (("position", place, "mm"), ("heading", heading, "degrees")):
        low, high = interval(values, settings.rate)
        print(
            f"  {name:<10} RMS {root_mean_square(values):.3f} {unit} (95 % interval {low:.3f} to {high:.3f}), "
            f"greatest {np.nanmax(np.abs(values)):.3f}"
        )
    print(f"  seen       {100 * seen.mean():.3f} % of {seen.size:,} robot frames ({seen.size - seen.sum()} predicted or lost)")
    print(f"  boxes      within {max(p.box_place for p in parts):.3f} mm, {max(p.box_heading for p in parts):.3f} degrees")
    print(f"  troubles   {'; '.join(sorted({t for p in parts for t in p.troubles})) or 'none'}")
    print(f"  rendering  {1000 * np.mean([p.render for p in parts]):.1f} ms of CPU a frame")
    speed = speed_of(settings)
    print(f"speed: {settings.timed_frames} frames x {settings.rounds}, one thread, both sides on the same frames in turn")
    for name, wall, processor in (
        ("tracker, windows", speed.tracker, speed.tracker_processor),
        ("pupil-apriltags, whole frame", speed.whole, speed.whole_processor),
    ):
        p50, p95 = np.percentile(wall, (50, 95))
        print(
            f"  {name:<30}{1 / wall.mean():>7.1f} frames/s ({1 / processor.mean():.1f} by CPU time); "
            f"a frame: p50 {1000 * p50:.2f}, p95 {1000 * p95:.2f}, worst {1000 * wall.max():.2f} ms"
        )
    ratio, by_processor = speed.whole.mean() / speed.tracker.mean(), speed.whole_processor.mean() / speed.tracker_processor.mean()
    print(f"  the tracker is {ratio:.1f} times as fast ({by_processor:.1f} by CPU time)")
    print("targets: position 2 mm, heading 1 degree, seen 99.5 %, 120 frames/s, 5 times the whole frame, p50 15 ms")


if __name__ == "__main__":
    main(tyro.cli(Settings))
