"""The driver on an emulated table: every way in which a motion can end, and what a game makes of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

from schemas import ROBOTS, Box, Command, Episode, Layout, Tick
from services.robot.core import RobotCore
from services.robot.settings import RobotSettings
from tests.drive.emulated import EmulatedTable, TrackerSettings, driver
from tests.services.robot_play import SEED, at_start, play
from vantage.service import SECOND


def test_two_hundred_primitives_end_where_the_simulation_has_them_although_lines_are_lost() -> None:
    rows, unreported = driver.play(driver.Settings(primitives=200, seed=4))
    assert unreported == 0
    moved = [row for row in rows if row.motion.result == "completed"]
    assert {row.motion.result for row in rows} <= {"completed", "refused"}
    assert len(moved) > 120 and len(rows) >= 202
    assert max(row.distance for row in rows) <= 0.002
    assert math.degrees(max(row.turn for row in rows)) <= 2.0
    # What it reports of itself is what is true, as well as a camera of this noise can tell.
    assert max(abs(row.motion.distance_error - row.distance) for row in moved) < 0.001
    assert max(row.motion.elapsed for row in moved if row.motion.step > 0) < 1.5


def test_a_move_into_a_wall_is_refused_and_not_begun() -> None:
    table = at_start()
    steps = 0
    while (motions := play(table, "forward", "stay", steps))["hider"].result == "completed":
        steps += 1
        assert steps < 120
    assert motions["hider"].result == "refused" and "collided" in motions["hider"].reason
    before = table.place_of("hider")
    again = play(table, "forward", "left", steps + 1)
    assert again["hider"].result == "refused" and again["seeker"].result == "completed"
    assert math.dist(before[:2], table.place_of("hider")[:2]) < 0.0005
    assert play(table, "left", "stay", steps + 2)["hider"].result == "completed"


def test_a_robot_held_by_something_that_nobody_knows_is_stuck_and_goes_on_from_where_it_is() -> None:
    table = at_start()
    x, y, heading = table.place_of("hider")
    ahead = 0.063 + 0.002 + 0.02
    post = Box(
        x=x + ahead * math.cos(heading), y=y + ahead * math.sin(heading), half_width=0.02, half_depth=0.02, heading=heading
    )
    table.boxes = EmulatedTable(obstacles=(post,)).boxes  # on the table, but not in the layout
    motion = play(table, "forward")["hider"]
    assert motion.result == "stuck"
    assert "something is in its way" in motion.reason
    assert 0.005 < motion.distance_error < 0.011
    # The next one is judged from the tracked place, not from where the simulation would have it.
    held = table.place_of("hider")
    assert play(table, "backward", step=1)["hider"].result == "completed"
    place = table.place_of("hider")
    wanted = math.radians(10 * round(math.degrees(held[2]) / 10))
    assert math.dist(place[:2], (held[0] - 0.01 * math.cos(wanted), held[1] - 0.01 * math.sin(wanted))) < 0.002


def test_a_robot_whose_wheels_do_not_turn_times_out() -> None:
    table = at_start()
    table.firmwares["hider"].body.settings = type(table.bodies["hider"].settings)(fastest=1e-6)
    motions = play(table, "forward", "left")
    assert motions["hider"].result == "timed-out"
    assert 1.5 <= motions["hider"].elapsed < 2.2
    assert motions["hider"].distance_error == pytest.approx(0.010, abs=0.002)
    assert motions["seeker"].result == "completed" and motions["seeker"].elapsed < 0.8


def test_a_robot_that_is_not_seen_stops_and_is_lost_but_a_short_while_does_no_harm() -> None:
    table = at_start()
    table.silent.add("hider")
    table.run(lambda: False, 0.7)
    table.say("hider/command", Command(stamp=table.now, episode=1, step=0, primitive="forward"))
    table.say("seeker/command", Command(stamp=table.now, episode=1, step=0, primitive="stay"))
    before = table.place_of("hider")
    table.run(lambda: False, 1.0)
    assert math.dist(before[:2], table.place_of("hider")[:2]) < 0.0005  # it does not drive blind
    table.silent.clear()
    assert table.run(lambda: len(table.motions) == 2, 1.5)
    assert dict(table.motions)["hider"].result == "completed"

    table.silent.add("hider")
    motion = play(table, "forward", step=1)["hider"]
    # It may have been done before the sight was missed; a step more, and it is not.
    if motion.result == "completed":
        motion = play(table, "forward", step=2)["hider"]
    assert motion.result == "lost" and "not seen" in motion.reason
    assert 1.9 < motion.elapsed < 2.6


@pytest.mark.parametrize("sights", [(), (0.9,), (1.3,), (0.4, 1.2), (0.7, 1.3, 1.9)])
def test_a_step_is_over_before_the_referee_gives_up_however_the_sight_comes_and_goes(sights: tuple[float, ...]) -> None:
    """The worst robot: its wheels do not turn. Seen at the given times (s) only, if at all."""
    table = at_start()
    table.firmwares["hider"].body.settings = type(table.bodies["hider"].settings)(fastest=1e-6)
    began = table.now
    table.say("hider/command", Command(stamp=table.now, episode=1, step=0, primitive="forward"))
    table.say("seeker/command", Command(stamp=table.now, episode=1, step=0, primitive="stay"))

    def reported() -> bool:
        since = (table.now - began) / SECOND
        (table.silent.discard if any(0.0 <= since - sight < 0.06 for sight in sights) else table.silent.add)("hider")
        return len(table.motions) == 2

    assert table.run(reported, 2.6), "a step takes too long"
    assert dict(table.motions)["hider"].result in ("lost", "timed-out")


def test_a_late_robot_stays_and_the_other_moves() -> None:
    table = at_start()
    table.say("seeker/command", Command(stamp=table.now, episode=1, step=0, primitive="left"))
    table.run(lambda: False, 0.2)
    assert table.motions == []
    table.say("tick", Tick(stamp=table.now, episode=1, step=0, late=("hider",)))
    assert table.run(lambda: len(table.motions) == 2, 2.0)
    assert {name: motion.primitive for name, motion in table.motions} == {"hider": "stay", "seeker": "left"}
    assert {motion.step for _, motion in table.motions} == {1}


def test_a_late_tick_or_a_second_command_in_mid_motion_does_not_command_the_next_step() -> None:
    table = at_start()
    for robot in ROBOTS:
        table.say(f"{robot}/command", Command(stamp=table.now, episode=1, step=0, primitive="forward"))
    table.run(lambda: False, 0.1)
    assert table.motions == []
    table.say("tick", Tick(stamp=table.now, episode=1, step=0, late=("hider",)))
    table.say("seeker/command", Command(stamp=table.now, episode=1, step=0, primitive="forward"))
    assert table.unexpected == 1
    assert table.run(lambda: len(table.motions) == 2, 3.0)
    motions = play(table, "left", "right", step=1)
    assert table.unexpected == 1
    assert {name: (motion.primitive, motion.result) for name, motion in motions.items()} == {
        "hider": ("left", "completed"),
        "seeker": ("right", "completed"),
    }


def test_commands_of_another_step_or_game_are_set_aside() -> None:
    table = at_start()
    for number, step in ((1, 1), (2, 0), (1, 5)):
        table.say("hider/command", Command(stamp=1, episode=number, step=step, primitive="left"))
    table.say("seeker/command", Command(stamp=1, episode=1, step=0, primitive="left"))
    table.say("seeker/command", Command(stamp=1, episode=1, step=0, primitive="left"))
    assert table.unexpected == 4
    assert not table.run(lambda: bool(table.motions), 0.5)


def test_the_end_of_a_game_stops_the_wheels_and_nothing_is_reported() -> None:
    table = at_start()
    for robot in ROBOTS:
        table.say(f"{robot}/command", Command(stamp=table.now, episode=1, step=0, primitive="forward"))
    table.run(lambda: table.bodies["hider"].left_speed > 0.03, 1.0)
    table.say("episode", Episode(stamp=table.now, episode=1, seed=SEED, phase="aborted"))
    table.run(lambda: False, 0.3)
    assert all(abs(body.left_speed) < 0.001 for body in table.bodies.values())
    assert table.motions == []


def restarted(table: EmulatedTable, heard: Sequence[str], step: int) -> None:
    """Put a new driver in place of the old one; it hears what late joiners hear, in the given order."""
    table.core = RobotCore(table.settings)
    table.motions.clear()
    said = {
        "episode": Episode(stamp=table.now, episode=1, seed=SEED, phase="running"),
        "layout": Layout(stamp=table.now, episode=1, obstacles=table.obstacles),
        "tick": Tick(stamp=table.now, episode=1, step=step),
        **{f"{robot}/command": Command(stamp=table.now, episode=1, step=step, primitive="forward") for robot in ROBOTS},
    }
    for key in heard:
        table.say(key, said[key])


@pytest.mark.parametrize(
    "heard",
    [
        ("episode", "layout", "tick", "hider/command", "seeker/command"),
        ("hider/command", "tick", "seeker/command", "layout", "episode"),
    ],
)
def test_a_driver_restarted_in_mid_step_does_not_repeat_it_and_goes_on_from_where_the_robots_are(heard: tuple[str, ...]) -> None:
    table = at_start()
    play(table, "forward", "left")
    before = {robot: table.place_of(robot) for robot in ROBOTS}
    restarted(table, heard, step=1)  # whether step 1 was begun, nobody can tell
    assert table.run(lambda: len(table.motions) == 2, 2.0)
    for robot, motion in table.motions:
        assert (motion.step, motion.result) == (2, "timed-out")
        assert "restarted" in motion.reason
        assert math.dist(before[robot][:2], table.place_of(robot)[:2]) < 0.0002
    motions = play(table, "forward", "backward", step=2)
    assert {motion.result for motion in motions.values()} == {"completed"}
    assert math.dist(before["hider"][:2], table.place_of("hider")[:2]) == pytest.approx(0.010, abs=0.002)


def test_a_driver_restarted_between_commands_carries_the_next_ones_out() -> None:
    table = at_start()
    restarted(table, ("episode", "layout", "tick"), step=0)
    table.run(lambda: False, 1.0)
    assert table.motions == []
    motions = play(table, "forward", "forward")
    assert {(motion.step, motion.result) for motion in motions.values()} == {(1, "completed")}


def test_a_robot_without_a_port_is_left_alone_and_driven_around() -> None:
    table = at_start()
    alone = EmulatedTable(
        places=[table.place_of(robot) for robot in ROBOTS], settings=RobotSettings(hider_port="pty-hider"), seed=3
    )
    alone.run(lambda: False, 0.3)
    alone.set_up(seed=SEED)
    assert alone.run(lambda: bool(alone.motions), 5.0)
    alone.motions.clear()
    for robot in ROBOTS:
        alone.say(f"{robot}/command", Command(stamp=alone.now, episode=1, step=0, primitive="left"))
    alone.run(lambda: False, 1.0)
    assert [(name, motion.result) for name, motion in alone.motions] == [("hider", "completed")]
    assert alone.bodies["seeker"].left == 0.0


def test_a_noisier_camera_is_believed_less() -> None:
    settings = driver.Settings(primitives=40, seed=2, tracker=TrackerSettings(missed=0.2, latency=0.08))
    rows, unreported = driver.play(settings)
    assert unreported == 0
    assert max(row.distance for row in rows if row.motion.result == "completed") <= 0.002
