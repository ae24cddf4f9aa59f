"""The lines to the robots: dead, damaged, slow, opened again; batteries; speeds said again and again."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from schemas import ROBOTS, Command
from services.robot.core import RobotCore
from services.robot.link import Link
from services.robot.settings import RobotSettings
from tests.drive.emulated import EmulatedTable, driver
from tests.services.robot_play import at_start, play
from vantage.drive.protocol import WATCHDOG, LineReader, SetSpeeds, Telemetry, encode
from vantage.rehearsal.firmware import FirmwareSettings
from vantage.service import SECOND, Captured, Woken, Write


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
    link = Link("hider", "/dev/x", silence=0.5)
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
    link = Link("hider", "/dev/x", silence=0.5)
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


def test_encoders_that_run_over_32_bits_tell_no_jump() -> None:
    link = Link("hider", "/dev/x", silence=0.5)
    now, highest, lowest = 10**15, 2**31 - 1, -(2**31)
    link.hear(encode(Telemetry(0, 8000, 0, highest - 1, lowest + 2, 8000, 0)), now)
    (second,) = link.hear(encode(Telemetry(1, 8020, 0, lowest + 1, highest, 8000, 0)), now + SECOND // 50)
    assert (second.left, second.right) == (3, -3)


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
