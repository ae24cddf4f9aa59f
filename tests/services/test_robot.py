"""The driver on an emulated table: every way in which a motion can end, and what a game makes of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import pytest

from schemas import ROBOTS, Box, Command, Control, Episode, Layout, Motion, Primitive, Tick
from services.robot.core import RobotCore
from services.robot.link import Link
from services.robot.settings import RobotSettings
from tests.drive.emulated import EmulatedTable, TrackerSettings, driver
from vantage.drive.protocol import EMERGENCY_STOP, WATCHDOG, EmergencyStop, LineReader, SetSpeeds, Telemetry, encode
from vantage.rehearsal.firmware import FirmwareSettings
from vantage.service import SECOND, Captured, Woken, Write
from vantage.world.layout import LAB
from vantage.world.start import draw_start

SEED = 5


def at_start(seed: int = SEED, obstacles: tuple[Box, ...] = (), **changes: object) -> EmulatedTable:
    """A table whose robots stand (almost) at the starts of episode 1, and whose driver has reported so."""
    empty = EmulatedTable(obstacles=obstacles)
    starts = draw_start(empty.boxes, 1.2, 1.2, seed, 0.25, 0.45)
    places = [(x + 0.0005, y - 0.0004, math.radians(10.0 * heading + 0.5)) for x, y, heading in starts]
    table = EmulatedTable(places=places, obstacles=obstacles, **changes)  # type: ignore[arg-type]
    table.run(lambda: False, 0.3)
    table.set_up(seed=seed)
    assert table.run(lambda: len(table.motions) == 2, 10.0), table.core.trouble
    assert [motion.result for _, motion in table.motions] == ["completed"] * 2
    table.motions.clear()
    return table


def play(
    table: EmulatedTable, hider: Primitive, seeker: Primitive = "stay", step: int = 0, limit: float = 5.0
) -> dict[str, Motion]:
    """Command one step; return both reports."""
    table.motions.clear()
    for robot, primitive in (("hider", hider), ("seeker", seeker)):
        table.say(f"{robot}/command", Command(stamp=table.now, episode=1, step=step, primitive=primitive))
    assert table.run(lambda: len(table.motions) == 2, 5.0), f"reported: {table.motions}"
    return dict(table.motions)


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


def ask_for_games(table: EmulatedTable, games: int = 1) -> None:
    table.say("control", Control(stamp=table.now, action="start", games=games))


def latch(table: EmulatedTable) -> None:
    """Press and release the hider's button."""
    for pressed in (True, False):
        table.firmwares["hider"].button = pressed
        table.run(lambda: False, 0.2)


HELD = "emergency stop of robot hider: release it and ask for a game (`vantage play`)"


def test_an_emergency_stop_is_cleared_when_a_person_asks_for_a_game_once_the_button_is_released() -> None:
    table = at_start()
    table.firmwares["hider"].button = True
    table.run(lambda: False, 0.1)
    motions = play(table, "forward", "forward")
    assert (motions["hider"].result, motions["hider"].reason) == ("stopped", HELD)
    assert motions["seeker"].result == "completed"
    assert table.core.trouble == HELD
    table.firmwares["hider"].button = False
    table.run(lambda: False, 0.3)
    assert table.core.trouble == HELD  # released is not cleared
    table.motions.clear()
    ask_for_games(table)
    table.set_up(number=2, seed=SEED)
    assert table.run(lambda: len(table.motions) == 2, 20.0)
    assert {motion.result for _, motion in table.motions} == {"completed"}
    assert table.core.trouble == ""


def test_the_next_of_ten_games_asked_for_before_it_does_not_clear_an_emergency_stop() -> None:
    table = at_start()
    ask_for_games(table, games=10)
    latch(table)
    before = {robot: table.place_of(robot) for robot in ROBOTS}
    for number in (2, 3):
        table.motions.clear()
        table.set_up(number=number, seed=SEED + 1)
        assert table.run(lambda: len(table.motions) == 2, 3.0)
        assert {(motion.step, motion.result, motion.reason) for _, motion in table.motions} == {(0, "stopped", HELD)}
        table.say("episode", Episode(stamp=table.now, episode=number, seed=SEED + 1, phase="aborted"))
    assert table.firmwares["hider"].flags & EMERGENCY_STOP
    assert all(math.dist(before[robot][:2], table.place_of(robot)[:2]) < 0.0005 for robot in ROBOTS)
    assert table.core.trouble == HELD


@pytest.mark.parametrize("pressed_again", [False, True])
def test_who_asks_while_the_button_is_pressed_or_before_it_is_pressed_again_must_ask_again(pressed_again: bool) -> None:
    table = at_start()
    if pressed_again:
        latch(table)
        ask_for_games(table)
        latch(table)
    else:
        table.firmwares["hider"].button = True
        table.run(lambda: False, 0.2)
        ask_for_games(table)
        table.firmwares["hider"].button = False
        table.run(lambda: False, 0.2)
    table.motions.clear()
    table.set_up(number=2, seed=SEED)
    assert table.run(lambda: len(table.motions) == 2, 3.0)
    assert {motion.result for _, motion in table.motions} == {"stopped"}
    assert table.firmwares["hider"].flags & EMERGENCY_STOP


@pytest.mark.parametrize("silent_when_asked", [False, True])
def test_who_asks_while_the_robot_is_out_of_reach_or_before_must_ask_again(silent_when_asked: bool) -> None:
    """Somebody may have pressed the button meanwhile."""
    table = at_start()
    latch(table)
    if not silent_when_asked:
        ask_for_games(table)
    table.firmwares["hider"].powered = False
    table.run(lambda: False, 1.0)
    if silent_when_asked:
        ask_for_games(table)
    table.firmwares["hider"].powered = True
    table.run(lambda: False, 0.3)
    table.motions.clear()
    table.set_up(number=2, seed=SEED)
    assert table.run(lambda: len(table.motions) == 2, 3.0)
    assert {motion.result for _, motion in table.motions} == {"stopped"}
    assert table.firmwares["hider"].flags & EMERGENCY_STOP


def test_the_wish_may_be_heard_just_after_the_game_it_led_to_and_the_wish_to_stop_is_none() -> None:
    table = at_start()
    latch(table)
    table.motions.clear()
    table.say("control", Control(stamp=table.now, action="stop"))
    table.set_up(number=2, seed=SEED)
    table.run(lambda: False, 0.4)
    assert table.firmwares["hider"].flags & EMERGENCY_STOP and table.motions == []
    ask_for_games(table)
    assert table.run(lambda: len(table.motions) == 2, 20.0)
    assert {motion.result for _, motion in table.motions} == {"completed"}


def test_an_emergency_stop_in_mid_motion_ends_it() -> None:
    table = at_start()
    table.say("hider/command", Command(stamp=table.now, episode=1, step=0, primitive="forward"))
    table.say("seeker/command", Command(stamp=table.now, episode=1, step=0, primitive="stay"))
    table.run(lambda: table.bodies["hider"].left_speed > 0.03, 1.0)
    table.firmwares["hider"].feed(encode(EmergencyStop(60_000)), table.now)
    assert table.run(lambda: len(table.motions) == 2, 2.0)
    assert dict(table.motions)["hider"].result == "stopped"


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


def test_a_robot_that_is_dead_is_named_and_the_other_goes_on() -> None:
    table = at_start()
    table.firmwares["hider"].powered = False
    motions = play(table, "forward", "forward")
    assert motions["hider"].result == "stopped"
    assert "robot hider does not answer on pty-hider" in motions["hider"].reason
    assert motions["hider"].elapsed < 0.8
    assert motions["seeker"].result == "completed"
    assert "hider does not answer" in table.core.trouble
    table.firmwares["hider"].powered = True
    table.run(lambda: False, 0.5)
    assert table.core.trouble == ""


def test_an_unplugged_port_is_named_until_it_is_open_again_and_then_a_robot_that_does_not_answer() -> None:
    table = at_start()
    table.firmwares["hider"].powered = False
    table.give(Captured("hider", None, table.now, "robot hider: /dev/x was unplugged"))
    table.run(lambda: False, 1.0)
    assert table.core.trouble == "robot hider: /dev/x was unplugged"
    table.give(Captured("hider", None, table.now))  # opened
    assert table.core.trouble == ""
    table.run(lambda: False, 1.0)
    assert "robot hider does not answer on pty-hider" in table.core.trouble
    table.firmwares["hider"].powered = True
    table.run(lambda: False, 0.5)
    assert table.core.trouble == ""


@pytest.mark.parametrize("opened", [True, False])
def test_a_robot_switched_on_again_does_not_jump_although_its_clock_is_ahead_of_its_last_word(opened: bool) -> None:
    """Silent for a minute, it then shows a later time than it last did, and counts from the start."""
    link = Link("hider", "/dev/x")
    now = 10**15
    for index in range(10):
        now += SECOND // 50
        link.hear(encode(Telemetry(index, 8000 + 20 * index, 0, 100_000 + 7 * index, -50_000, 8000, 0)), now)
    now += 60 * SECOND
    if opened:
        link.opened(now)
    (first,) = link.hear(encode(Telemetry(0, 9000, 0, 3, 4, 8000, 0)), now)
    (second,) = link.hear(encode(Telemetry(1, 9020, 0, 5, 4, 8000, 0)), now + SECOND // 50)
    assert (first.left, first.right, first.stamp) == (0, 0, now)
    assert (second.left, second.right) == (2, 0)
    assert second.stamp == pytest.approx(now + SECOND // 50, abs=1_000_000)


def test_a_port_opened_again_forgets_what_was_measured_before() -> None:
    """At once, with a clock that goes on as it should: the counts are another robot's."""
    link = Link("hider", "/dev/x")
    now = 10**15
    link.hear(encode(Telemetry(0, 8000, 0, 100_000, -50_000, 8000, 0)), now)
    link.hear(b"$T,1*0000\n" * 200 + b"$T,1,80", now)
    assert link.damaged == 1.0
    link.opened(now + SECOND // 10)
    assert link.damaged == 0.0
    (first,) = link.hear(encode(Telemetry(0, 8100, 0, 3, 4, 8000, 0)), now + SECOND // 10)
    assert (first.left, first.right) == (0, 0)
    link.hear(encode(Telemetry(1, 8120, 0, 3, 4, 8000, 0)) * 198, now + SECOND // 8)
    assert link.damaged == 0.0  # nor does the torn line count


def test_a_cable_that_damages_many_lines_is_trouble_and_one_that_damages_few_is_not() -> None:
    bad, good = EmulatedTable(firmware=FirmwareSettings(damaged=0.15)), EmulatedTable(firmware=FirmwareSettings(damaged=0.01))
    for table in (bad, good):
        table.run(lambda: False, 6.0)
    for robot in ROBOTS:
        assert f"robot {robot}: " in bad.core.trouble
    assert "of its lines come damaged" in bad.core.trouble
    assert good.core.trouble == ""


def test_a_low_battery_is_trouble_and_the_voltage_is_in_every_report() -> None:
    table = at_start(firmware=FirmwareSettings(full=6.35))
    assert "robot hider: battery at 6.3 V, charge it" in table.core.trouble or "6.4 V" in table.core.trouble
    battery = play(table, "left")["hider"].battery
    assert battery == pytest.approx(6.35, abs=0.02)


@pytest.mark.parametrize("loss", [{"dropped": 0.15}, {"damaged": 0.15}, {"latency": 0.02, "jitter": 0.06}])
def test_worse_cables_cost_time_not_truth(loss: dict[str, float]) -> None:
    settings = driver.Settings(primitives=40, seed=9, firmware=FirmwareSettings(**loss))  # type: ignore[arg-type]
    rows, unreported = driver.play(settings)
    assert unreported == 0
    for row in rows:
        if row.motion.result == "completed":
            assert row.distance <= 0.002 and row.turn <= math.radians(2.0)


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


def test_speeds_are_sent_again_at_least_twenty_times_a_second_and_never_after_the_motion() -> None:
    """Without a word from the robot, too: an own clock, no emulator."""
    core = RobotCore(RobotSettings(hider_port="x"))
    reader = LineReader()
    now = 10**15
    sent = []
    for _ in range(1000):
        now += SECOND // 1000
        wake = core.wake_at()
        if wake is not None and wake <= now:
            for send in core.step(Woken(), now):
                assert isinstance(send, Write)
                sent += [(now, line) for line in reader.feed(send.data)]
    assert 9 <= len(sent) <= 12  # idle
    assert not any(isinstance(line, SetSpeeds) for _, line in sent)


def test_a_noisier_camera_is_believed_less() -> None:
    settings = driver.Settings(primitives=40, seed=2, tracker=TrackerSettings(missed=0.2, latency=0.08))
    rows, unreported = driver.play(settings)
    assert unreported == 0
    assert max(row.distance for row in rows if row.motion.result == "completed") <= 0.002


def test_encoders_that_run_over_32_bits_tell_no_jump() -> None:
    link = Link("hider", "/dev/x")
    now, highest, lowest = 10**15, 2**31 - 1, -(2**31)
    link.hear(encode(Telemetry(0, 8000, 0, highest - 1, lowest + 2, 8000, 0)), now)
    (second,) = link.hear(encode(Telemetry(1, 8020, 0, lowest + 1, highest, 8000, 0)), now + SECOND // 50)
    assert (second.left, second.right) == (3, -3)


def test_who_asks_before_a_port_is_opened_again_must_ask_again() -> None:
    """However short that was: somebody may have pressed the button meanwhile, or it is another robot."""
    link = Link("hider", "/dev/x")
    now = 10**15
    latched = Telemetry(0, 8000, 0, 0, 0, 8000, EMERGENCY_STOP)
    link.hear(encode(latched), now)
    link.asked()
    assert link.may_clear
    link.opened(now + SECOND // 10)
    link.hear(encode(latched), now + SECOND // 8)
    assert link.can_clear and not link.may_clear


def test_speeds_are_sent_again_before_the_watchdog_stops_a_moving_robot_that_says_nothing() -> None:
    """Lines to the robot are lost as well: several must fit into the watchdog's time."""
    table = at_start()
    for robot in ROBOTS:
        table.say(f"{robot}/command", Command(stamp=table.now, episode=1, step=0, primitive="forward"))
    assert table.run(lambda: table.bodies["hider"].left_speed > 0.03, 1.0)
    sent: list[int] = []
    hider = table.firmwares["hider"]
    hider.feed = lambda data, now: sent.append(now)  # type: ignore[method-assign]
    hider.advance = lambda now, boxes, other: b""  # type: ignore[method-assign]
    began = table.now
    table.run(lambda: False, 0.3)
    assert table.motions == [] and len(sent) >= 5
    assert max(after - before for before, after in pairwise([began, *sent, table.now])) < 0.25 * WATCHDOG * SECOND
