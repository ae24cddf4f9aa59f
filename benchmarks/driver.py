"""How well primitives are carried out: the driver's real core and real protocol lines against emulated robots, in virtual time.

Emulated: wheels that lag, slip and are not of the size they are said to be, lines that come late or never, a camera of 30
frames a second that is 40 ms late, noisy, and misses frames. After every motion the true place of the robot is compared with
where the simulation would have put it: errors do not add up only if each is corrected. A motion that did not complete is
compared, too, and the robot goes on from where it is. `python benchmarks/driver.py --help` shows the settings.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
import tyro
from emulated_table import EmulatedTable, TrackerSettings

from schemas import PRIMITIVES, ROBOTS, Command, Motion
from vantage.rehearsal.body import BodySettings
from vantage.rehearsal.firmware import FirmwareSettings
from vantage.world.arena import STAY, TURN
from vantage.world.game import move_both
from vantage.world.layout import boxes_array, make_layout
from vantage.world.motion import heading_number
from vantage.world.start import draw_start

MIX = (0.10, 0.35, 0.15, 0.20, 0.20)
"""Shares of stay, forward, backward, left, right."""


@dataclass(frozen=True)
class Settings:
    """Drives both robots through random primitives and prints how far they end from where they ought to be."""

    primitives: int = 1000
    """of both robots together"""
    layout: str = "lab"
    """lab, random, or the path of a layout file"""
    seed: int = 1
    """of the primitives, slips, noise and losses"""
    steps: int = 100
    """of a game, after which the robots drive to new starts"""
    body: BodySettings = field(default_factory=BodySettings)
    firmware: FirmwareSettings = field(default_factory=FirmwareSettings)
    tracker: TrackerSettings = field(default_factory=TrackerSettings)


@dataclass
class Row:
    """One motion: its report, and the true errors (m, rad) after it, from where the simulation would have put the robot."""

    motion: Motion
    distance: float
    turn: float


def play(settings: Settings) -> tuple[list[Row], int]:
    """Drive; return a row for each motion (starts included, as step 0), and how many motions were never reported."""
    obstacles = make_layout(settings.layout, settings.seed)
    table = EmulatedTable(
        obstacles=obstacles,
        places=((0.15, 0.15, 0.4), (1.05, 1.05, 2.0)),
        body=settings.body,
        firmware=settings.firmware,
        tracker=settings.tracker,
        seed=settings.seed,
    )
    generator = np.random.default_rng(settings.seed)
    boxes = boxes_array(obstacles)
    rows: list[Row] = []
    unreported = left = 0
    episode = 0
    ideal = np.zeros((2, 3))
    step = settings.steps
    left = settings.primitives
    while left > 0:
        if step >= settings.steps:
            episode, step = episode + 1, 0
            seed = settings.seed + episode
            ideal[:] = draw_start(boxes, 1.2, 1.2, seed, 0.25, 0.45)
            primitives = np.full(2, STAY)
            table.motions.clear()
            table.set_up(episode, seed)
        else:
            primitives = generator.choice(len(PRIMITIVES), 2, p=MIX)
            moved = np.empty(2, np.bool_)
            move_both(boxes, 1.2, 1.2, ideal, primitives, ideal, moved)
            table.motions.clear()
            for robot, primitive in zip(ROBOTS, primitives, strict=True):
                message = Command(stamp=table.now, episode=episode, step=step, primitive=PRIMITIVES[primitive])
                table.say(f"{robot}/command", message)
            step += 1
            left -= 2
        reported = 0
        limit = table.now + (300 if step == 0 else 6) * 1_000_000_000
        while reported < 2 and table.now < limit:
            if len(table.motions) == reported:
                table.tick()
                continue
            robot, motion = table.motions[reported]
            reported += 1
            x, y, heading = table.place_of(robot)
            row = ideal[ROBOTS.index(robot)]  # type: ignore[arg-type]
            error = math.hypot(x - row[0], y - row[1]), abs(math.remainder(heading - row[2] * TURN, math.tau))
            rows.append(Row(motion, *error))
            place = table.core.place_of(robot)
            if motion.result not in ("completed", "refused") and place is not None:
                row[:] = place.x, place.y, heading_number(place.heading)  # as the driver goes on, from where it is tracked
        if reported < 2:
            unreported += 2 - reported
            step = settings.steps
    return rows, unreported


def main(settings: Settings) -> None:
    began = time.perf_counter()
    rows, unreported = play(settings)
    wall = time.perf_counter() - began
    motions = [row for row in rows if row.motion.step > 0]
    print(f"{len(motions)} primitives, {len(rows) - len(motions)} drives to a start, in {wall:.1f} s of this machine")
    parts = "".join(f"{f'{unit} max':>9s}{'99 %':>7s}{'RMS':>7s}" for unit in ("mm", "deg"))
    print(f"{'':12s}{'count':>7s}{parts}{'s mean':>9s}{'95 %':>7s}   (times of those completed)")
    for name in ("starts", "all", *PRIMITIVES):
        chosen = [row for row in motions if name in ("all", row.motion.primitive)]
        if name == "starts":
            chosen = [row for row in rows if row.motion.step == 0]
        if not chosen:
            continue
        distance = 1000.0 * np.array([row.distance for row in chosen])
        turn = np.degrees([row.turn for row in chosen])
        seconds = np.array([row.motion.elapsed for row in chosen if row.motion.result == "completed"] or [math.nan])
        figures = [np.max(distance), np.quantile(distance, 0.99), np.sqrt(np.mean(distance**2))]
        angles = [np.max(turn), np.quantile(turn, 0.99), np.sqrt(np.mean(turn**2))]
        print(
            f"{name:12s}{len(chosen):7d}{figures[0]:9.2f}{figures[1]:7.2f}{figures[2]:7.2f}"
            f"{angles[0]:9.2f}{angles[1]:7.2f}{angles[2]:7.2f}{np.mean(seconds):9.3f}{np.quantile(seconds, 0.95):7.3f}"
        )
    print(
        "results:", ", ".join(f"{count} {result}" for result, count in Counter(row.motion.result for row in rows).most_common())
    )
    assumed = sum(row.distance > 0.002 or row.turn > math.radians(2.0) for row in rows if row.motion.result == "completed")
    print(f"never reported: {unreported}; reported completed but farther than 2 mm or 2 degrees off: {assumed}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
