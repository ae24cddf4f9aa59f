"""The driver beside a camera whose machine has another clock: how old a picture is, the driver tells by its own."""

from __future__ import annotations

import math

import pytest

from schemas import ROBOTS, Command, Track
from services.robot.core import RobotCore
from tests.drive.emulated import EmulatedTable, TrackerSettings
from tests.services.robot_play import at_start, play
from vantage.service import SECOND, Arrived, SenderClock

CLOCKS = [-3600.0, -10.0, -0.3, 0.0, 0.3, 10.0, 3600.0]
MILLISECOND = SECOND // 1000


@pytest.mark.parametrize("clock", CLOCKS)
def test_a_robot_drives_as_well_whatever_time_it_is_at_the_camera(clock: float) -> None:
    table = at_start(tracker=TrackerSettings(clock=clock))
    for step in range(6):
        motions = play(table, "forward", "left", step)
        assert {motion.result for motion in motions.values()} <= {"completed", "refused"}, motions
        assert max(motion.elapsed for motion in motions.values()) < 1.0


@pytest.mark.parametrize("clock", CLOCKS)
def test_a_robot_that_is_not_seen_stops_whatever_time_it_is_at_the_camera(clock: float) -> None:
    """On its way to a start 0.5 m away, at 0.2 m/s: it must not drive on for longer than 0.5 s."""
    table = EmulatedTable(tracker=TrackerSettings(clock=clock))
    table.set_up()
    assert table.run(lambda: any(abs(body.left_speed + body.right_speed) > 0.3 for body in table.bodies.values()), 30.0)
    table.silent.update(ROBOTS)
    before = {robot: table.place_of(robot) for robot in ROBOTS}
    table.run(lambda: False, 1.5)
    gone = max(math.dist(before[robot][:2], table.place_of(robot)[:2]) for robot in ROBOTS)
    assert gone < 0.2 * (0.5 + table.tracker.latency + 0.1)
    assert all(abs(body.left_speed) < 0.001 for body in table.bodies.values())


@pytest.mark.parametrize("jump", [-7.0, -0.2, 0.2, 7.0])
def test_a_clock_that_is_set_during_a_game_costs_a_few_pictures(jump: float) -> None:
    table = at_start()
    assert play(table, "forward")["hider"].result == "completed"
    table.clock += int(jump * SECOND)
    for step in range(1, 5):
        motions = play(table, "forward", "left", step)
        assert {motion.result for motion in motions.values()} <= {"completed", "refused"}, motions
        assert max(motion.elapsed for motion in motions.values()) < 1.5


def test_a_picture_that_comes_again_and_again_is_not_a_new_one() -> None:
    """A camera that hangs: its tracker goes on saying what the last picture showed."""
    table = at_start()
    table.run(lambda: False, 0.2)
    x, y, heading = table.place_of("hider")
    last = Track(stamp=table.now, x=x, y=y, heading=math.remainder(heading, math.tau))
    table.silent.add("hider")
    for robot, primitive in (("hider", "forward"), ("seeker", "stay")):
        table.say(f"{robot}/command", Command(stamp=table.now, episode=1, step=0, primitive=primitive))  # type: ignore[arg-type]
    began = table.now

    def reported() -> bool:
        table.give(Arrived("hider/track", last, table.now))
        return len(table.motions) == 2

    assert table.run(reported, 3.0)
    assert dict(table.motions)["hider"].result in ("lost", "timed-out")
    assert table.now - began > SECOND


def test_a_picture_kept_from_before_does_not_start_a_robot() -> None:
    """Who joins late is given the last track, however old it is; alone, it is no sight of a robot."""
    core = RobotCore(EmulatedTable().settings)
    now = 1000 * SECOND
    core.step(Arrived("hider/track", Track(stamp=now - 600 * SECOND, x=0.5, y=0.5, heading=0.0)), now)
    assert core.place_of("hider") is None


def test_time_in_which_the_driver_did_not_run_is_no_silence_of_robots_or_cameras() -> None:
    table = at_start()
    for robot in ROBOTS:
        table.say(f"{robot}/command", Command(stamp=table.now, episode=1, step=0, primitive="forward"))
    table.run(lambda: False, 0.1)
    assert table.motions == []
    core, lag = table.core, 3 * SECOND
    sent = core._robots["hider"].link.last_sent
    # The driver stands still for 3 s, and what came meanwhile is lost.
    table.core = _Deaf(core)  # type: ignore[assignment]
    table.run(lambda: False, lag / SECOND)
    table.core = core
    core.held_up(lag, table.now)
    assert core._robots["hider"].link.last_sent == sent
    assert core.trouble == ""
    assert table.run(lambda: len(table.motions) == 2, 3.0)
    assert {motion.result for _, motion in table.motions} <= {"completed", "timed-out"}
    assert core.trouble == ""


class _Deaf:
    """Stands for a driver that does not run."""

    def __init__(self, core: RobotCore) -> None:
        self.core = core

    def step(self, received: object, now: int) -> tuple[()]:
        return ()

    def wake_at(self) -> None:
        return None


def test_a_senders_stamps_are_told_in_the_own_time() -> None:
    """Published 30 ms after each picture, travelling 1 to 5 ms: the earliest arrival tells the clocks apart to a millisecond."""
    clock, ahead = SenderClock(), 42 * SECOND
    wrong = []
    for index in range(1, 200):
        taken = 1000 * SECOND + index * 33 * MILLISECOND
        published = taken + 30 * MILLISECOND
        arrival = published + (1 + 7 * index % 5) * MILLISECOND
        own = clock.take(taken + ahead, published + ahead, arrival)
        assert (own is None) == (index == 1)
        if own is not None and index > 10:
            wrong.append(own - taken)
    assert min(wrong) >= 0 and max(wrong) <= 2 * MILLISECOND


def test_a_message_that_comes_late_is_as_old_as_it_is() -> None:
    clock = SenderClock()
    for index in range(20):
        clock.take(index * SECOND // 10, 0, 50 * SECOND + index * SECOND // 10)
    late = clock.take(2 * SECOND, 0, 50 * SECOND + 27 * SECOND // 10)
    assert late == pytest.approx(52 * SECOND, abs=2 * MILLISECOND)


def test_own_time_never_runs_backwards_and_never_ahead() -> None:
    clock, last = SenderClock(), 0
    for index in range(1, 300):
        now = 10**15 + index * 20 * MILLISECOND
        ahead = {0: 0, 1: 5 * SECOND, 2: -5 * SECOND}[index // 50 % 3]
        own = clock.take(now + ahead - (index * 7919 % 13) * MILLISECOND, 0, now)
        if own is not None:
            assert last < own <= now
            last = own
    assert last > now - SECOND // 10
