"""The driver brings the robots to the starts of a game, or says why not."""

from __future__ import annotations

import math

from schemas import ROBOTS, Box
from tests.drive.emulated import EmulatedTable
from tests.services.robot_play import SEED
from vantage.service import SECOND
from vantage.world.layout import LAB
from vantage.world.start import draw_start


def test_both_robots_drive_to_their_starts_around_boxes_and_each_other() -> None:
    """They begin at each other's ends of the table; the body of the emulator stops where it touches anything."""
    starts = draw_start(EmulatedTable(obstacles=LAB).boxes, 1.2, 1.2, SEED, 0.25, 0.45)
    table = EmulatedTable(places=((0.12, 0.12, 0.3), (1.08, 1.08, -2.0)), obstacles=LAB)
    table.set_up(seed=SEED)
    moving = set()
    touched = False

    def reported() -> bool:
        nonlocal touched
        speeds = {robot: abs(body.left_speed) + abs(body.right_speed) for robot, body in table.bodies.items()}
        moving.add(tuple(speed > 0.01 for speed in speeds.values()))
        touched = touched or any(body.touching for body in table.bodies.values())
        return len(table.motions) == 2

    assert table.run(reported, 90.0), table.core.trouble
    assert (True, True) not in moving and not touched
    for robot, (x, y, heading) in zip(ROBOTS, starts, strict=True):
        motion = dict(table.motions)[robot]
        assert (motion.step, motion.primitive, motion.result, motion.reason) == (0, "stay", "completed", "")
        place = table.place_of(robot)
        assert math.dist(place[:2], (x, y)) <= 0.002
        assert abs(math.remainder(place[2] - math.radians(10 * heading), math.tau)) <= math.radians(2.0)
    assert table.core.trouble == ""


def test_robots_that_stand_on_each_others_starts_make_way() -> None:
    first, second = draw_start(EmulatedTable().boxes, 1.2, 1.2, SEED, 0.25, 0.45)
    table = EmulatedTable(places=((second[0], second[1], 0.0), (first[0], first[1], 0.0)))
    table.set_up(seed=SEED)
    assert table.run(lambda: len(table.motions) == 2, 90.0), table.core.trouble
    assert {motion.result for _, motion in table.motions} == {"completed"}


def test_a_start_that_cannot_be_reached_is_said_and_the_game_given_up() -> None:
    """Walls of boxes around the hider; wherever the start of this seed is, it is outside."""
    cage = tuple(
        Box(x=0.2 + 0.14 * dx, y=0.2 + 0.14 * dy, half_width=0.13 if dy else 0.02, half_depth=0.02 if dy else 0.13)
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))
    )
    table = EmulatedTable(places=((0.2, 0.2, 0.0), (0.9, 0.9, 0.0)), obstacles=cage)
    table.set_up(seed=SEED)
    assert table.run(lambda: "no way to the start of hider" in table.core.trouble, 60.0)
    assert table.motions == []
    assert table.run(lambda: len(table.motions) == 2, 15.0)
    assert {(motion.step, motion.result) for _, motion in table.motions} == {(0, "stopped")}
    assert "no way" in table.motions[0][1].reason


def test_a_robot_that_goes_on_and_is_stuck_again_and_again_does_not_keep_people_waiting_for_ever() -> None:
    """At a post that no tag tells of: every new plan begins with a line back to the grid, which it can drive."""
    _, (seeker_x, seeker_y, _) = draw_start(EmulatedTable(obstacles=LAB).boxes, 1.2, 1.2, SEED, 0.25, 0.45)
    table = EmulatedTable(places=((0.12, 0.12, 0.3), (seeker_x, seeker_y, 0.0)), obstacles=LAB)
    post = Box(x=0.4647, y=0.5212, half_width=0.02, half_depth=0.02)
    table.boxes = EmulatedTable(obstacles=(*LAB, post)).boxes
    table.set_up(seed=SEED)
    began = table.now
    assert table.run(lambda: len(table.motions) == 2, 61.0), "still trying"
    assert table.now - began > 30 * SECOND  # it was no lack of progress
    x, y, _ = table.place_of("hider")
    for _, motion in table.motions:
        assert (motion.step, motion.result) == (0, "stopped")
        assert f"robot hider did not get to its start and stands at ({x:.2f}, {y:.2f}) m: stuck" in motion.reason
    table.run(lambda: False, 1.0)
    assert all(abs(body.left_speed) < 0.001 for body in table.bodies.values())
