"""The emulated firmware: acknowledges, measures, watches over itself, and its cable loses what it is told to lose."""

import math

import pytest

from vantage.drive.protocol import (
    BUTTON,
    EMERGENCY_STOP,
    LOW_BATTERY,
    WATCHDOG_STOP,
    Acknowledgement,
    ClearEmergencyStop,
    EmergencyStop,
    Line,
    LineReader,
    Query,
    SetSpeeds,
    Stop,
    Telemetry,
    encode,
)
from vantage.rehearsal.body import Body, BodySettings
from vantage.rehearsal.firmware import Firmware, FirmwareSettings
from vantage.world.layout import boxes_array

NOTHING = boxes_array(())
MS = 1_000_000


class Cable:
    """The driver's end of an emulated robot's cable, in virtual time."""

    def __init__(self, **settings: float) -> None:
        chosen = {"dropped": 0.0, **settings}
        self.firmware = Firmware(Body(BodySettings(), 0.6, 0.6, 0.0), FirmwareSettings(**chosen), seed=4)  # type: ignore[arg-type]
        self.reader = LineReader()
        self.now = 10**12
        self.firmware.advance(self.now, NOTHING, None)

    def pass_time(self, milliseconds: int) -> list[Line]:
        lines: list[Line] = []
        for _ in range(milliseconds):
            self.now += MS
            lines += self.reader.feed(self.firmware.advance(self.now, NOTHING, None))
        return lines

    def say(self, line: Line) -> None:
        self.firmware.feed(encode(line), self.now)


def last_telemetry(lines: list[Line]) -> Telemetry:
    return [line for line in lines if isinstance(line, Telemetry)][-1]


def test_it_acknowledges_with_the_sequence_number_after_the_latency() -> None:
    cable = Cable(latency=0.004, jitter=0.0)
    cable.say(Query(77))
    assert not any(isinstance(line, Acknowledgement) for line in cable.pass_time(7))
    assert Acknowledgement(77, 0) in cable.pass_time(6)


def test_telemetry_comes_fifty_times_a_second_and_counts_ticks() -> None:
    cable = Cable()
    lines = []
    for sequence in range(20):
        cable.say(SetSpeeds(sequence, 100, 50))
        lines += cable.pass_time(50)
    telemetry = [line for line in lines if isinstance(line, Telemetry)]
    assert len(telemetry) in (49, 50, 51)
    assert [line.sequence for line in telemetry] == list(range(len(telemetry)))
    metres = 0.1 / (math.tau * 0.016) * 1440
    assert telemetry[-1].left == pytest.approx(metres, rel=0.08)
    assert telemetry[-1].right == pytest.approx(metres / 2, rel=0.08)
    assert 8200 < telemetry[-1].battery <= 8300


def test_without_lines_it_stops_after_its_watchdog_and_says_so() -> None:
    cable = Cable(jitter=0.0)
    cable.say(SetSpeeds(1, 100, 100))
    assert not last_telemetry(cable.pass_time(300)).flags & WATCHDOG_STOP
    assert cable.firmware.body.left_speed > 0.09
    assert last_telemetry(cable.pass_time(300)).flags & WATCHDOG_STOP
    assert cable.firmware.body.left_speed < 0.001
    cable.say(SetSpeeds(2, 100, 100))
    assert not last_telemetry(cable.pass_time(100)).flags & WATCHDOG_STOP
    assert cable.firmware.body.left_speed > 0.05


def test_an_emergency_stop_holds_until_it_is_cleared_and_not_while_the_button_is_pressed() -> None:
    cable = Cable()
    cable.say(EmergencyStop(1))
    cable.pass_time(20)
    cable.say(SetSpeeds(2, 100, 100))
    assert last_telemetry(cable.pass_time(100)).flags & EMERGENCY_STOP
    assert cable.firmware.body.left == 0.0
    cable.firmware.button = True
    cable.say(ClearEmergencyStop(3))
    assert last_telemetry(cable.pass_time(60)).flags == EMERGENCY_STOP | BUTTON
    cable.firmware.button = False
    assert last_telemetry(cable.pass_time(60)).flags == EMERGENCY_STOP
    cable.say(ClearEmergencyStop(4))
    cable.say(SetSpeeds(5, 100, 100))
    assert last_telemetry(cable.pass_time(100)).flags == 0
    assert cable.firmware.body.left > 0.0
    cable.say(Stop(6))
    cable.pass_time(200)
    assert cable.firmware.body.left_speed < 0.005


def test_damaged_lines_are_refused_and_counted() -> None:
    cable = Cable(damaged=1.0)
    for sequence in range(50):
        cable.say(SetSpeeds(sequence, 500, 500))
        assert cable.pass_time(20) == []
    assert cable.firmware.refused >= 45
    assert cable.firmware.body.left == 0.0
    assert cable.reader.damaged >= 45


def test_lines_are_lost_at_the_rate_it_is_told_to() -> None:
    cable = Cable(dropped=0.2)
    answers = 0
    for sequence in range(1000):
        cable.say(Query(sequence))
        answers += sum(isinstance(line, Acknowledgement) for line in cable.pass_time(4))
    assert answers / 1000 == pytest.approx(0.8 * 0.8, abs=0.05)


def test_switched_off_it_says_nothing_and_a_low_battery_is_flagged() -> None:
    cable = Cable(full=6.3)
    assert last_telemetry(cable.pass_time(50)).flags == LOW_BATTERY
    cable.firmware.powered = False
    cable.pass_time(30)
    cable.say(Query(1))
    assert cable.pass_time(100) == []
