"""One robot's serial line as the driver sees it: what is sent and acknowledged, what the robot measures, whether it answers."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from vantage.drive.protocol import (
    BUTTON,
    EMERGENCY_STOP,
    LOW_BATTERY,
    SEQUENCES,
    Acknowledgement,
    ClearEmergencyStop,
    LineReader,
    SetSpeeds,
    Stop,
    Telemetry,
    encode,
)
from vantage.service import SECOND, Write

SILENT_LINES = 5
"""Lines that must have gone unanswered for that, too: a driver that was held up itself blames nobody."""
CLOCK_DRIFT = 1e-4
"""How much faster than ours a robot's clock may run, relatively."""
JUMP = SECOND // 2
"""ns by which a robot's clock may differ from what it should show; beyond, it was switched on again and counts from the start."""
LINES = 200
"""Lines received lately that are judged, ..."""
DAMAGED_SHARE = 0.05
"""... of which this share may be damaged."""


class Measurement(NamedTuple):
    """When (ns, our clock) the robot measured, which of our lines it had taken by then, and by how many ticks each wheel
    had turned since the last time."""

    stamp: int
    taken: int
    left: int
    right: int


class Link:
    """See module.

    Args:
        silence: s without acknowledgement or telemetry after which the robot does not answer.

    Attributes:
        robot: its name, which is the device's, too.
        port: path, for people.
        unplugged: why the port is not open, for people; empty while it is.
        flags: what the robot last said of itself.
        battery: V; None before it said.
    """

    def __init__(self, robot: str, port: str, silence: float) -> None:
        self.robot = robot
        self._silence = int(silence * SECOND)
        self.port = port
        self.unplugged = ""
        self.flags = 0
        self.battery: float | None = None
        self._reader = LineReader()
        self._sequence = 0
        self._unanswered: deque[tuple[int, int]] = deque(maxlen=256)  # sequence, when sent
        self._telemetry: Telemetry | None = None
        self._heard_at: int | None = None  # telemetry
        self._silent_since: int | None = None  # the same, less what the driver was held up
        self._sent_since_telemetry = 0
        self._offset = 0  # our clock minus the robot's, ns
        self._lately: deque[bool] = deque(maxlen=LINES)  # whether a line received was damaged
        self._may_clear = False
        self.last_sent: int | None = None

    @property
    def sequence(self) -> int:
        """Number of the last line sent."""
        return (self._sequence - 1) % SEQUENCES

    @property
    def damaged(self) -> float:
        """Share of the lines received lately that were damaged; 0 before there are enough of them."""
        return sum(self._lately) / LINES if len(self._lately) == LINES else 0.0

    @property
    def emergency_stop(self) -> bool:
        return bool(self.flags & EMERGENCY_STOP)

    @property
    def held(self) -> bool:
        """Whether an emergency stop holds the robot: latched, or its button is pressed."""
        return bool(self.flags & (EMERGENCY_STOP | BUTTON))

    @property
    def can_clear(self) -> bool:
        """Whether an emergency stop is latched whose button is released."""
        return self.emergency_stop and not self.flags & BUTTON

    @property
    def may_clear(self) -> bool:
        """Whether a person has asked for a game since that: only then it is cleared."""
        return self._may_clear

    def asked(self) -> None:
        """Take note that a person asked for a game: it counts for a robot known to be latched, with its button released."""
        self._may_clear = self.can_clear

    @property
    def low_battery(self) -> bool:
        return bool(self.flags & LOW_BATTERY)

    def set_speeds(self, left: float, right: float, now: int) -> Write:
        """Return the line that turns the wheels at these speeds, m/s."""
        return self._say(SetSpeeds(self._next(), round(1000.0 * left), round(1000.0 * right)), now)

    def stop(self, now: int) -> Write:
        return self._say(Stop(self._next()), now)

    def clear(self, now: int) -> Write:
        return self._say(ClearEmergencyStop(self._next()), now)

    def hear(self, data: bytes, now: int) -> list[Measurement]:
        """Take bytes that came at a time (ns); return what was measured."""
        measurements = []
        damaged = self._reader.damaged
        lines = self._reader.feed(data)
        self._lately.extend([True] * (self._reader.damaged - damaged) + [False] * len(lines))
        for line in lines:
            if isinstance(line, Acknowledgement):
                self._acknowledged(line)
            elif isinstance(line, Telemetry):
                measurements.append(self._measured(line, now))
        return measurements

    def held_up(self, lag: int) -> None:
        """Do not count `lag` ns in which the driver itself did not run: the robot's answers may wait to be read."""
        self._unanswered = deque(((sequence, sent + lag) for sequence, sent in self._unanswered), maxlen=self._unanswered.maxlen)
        if self._silent_since is not None:
            self._silent_since += lag

    def silent(self, now: int) -> bool:
        """Whether the robot does not answer."""
        unanswered = len(self._unanswered) >= SILENT_LINES and now - self._unanswered[0][1] > self._silence
        since = self._silent_since
        unheard = self._sent_since_telemetry >= SILENT_LINES and (since is None or now - since > self._silence)
        return unanswered or unheard

    def opened(self, now: int) -> None:
        """Take note that the port has been opened (again): what was sent and heard before counts no more."""
        self.unplugged = ""
        self._reader = LineReader()
        self._lately.clear()
        self._telemetry = None
        self._may_clear = False
        self._unanswered.clear()
        self._sent_since_telemetry = 0
        self._heard_at = self._silent_since = now

    def trouble(self, now: int) -> str:
        """Return what is wrong, for people; empty when nothing."""
        if self.unplugged:
            return self.unplugged
        if self.silent(now):
            return f"robot {self.robot} does not answer on {self.port}: is it switched on, is it the right port?"
        if self.held:
            return f"emergency stop of robot {self.robot}: release it and ask for a game (`vantage play`)"
        return ""

    def _next(self) -> int:
        sequence, self._sequence = self._sequence, (self._sequence + 1) % SEQUENCES
        return sequence

    def _say(self, line: SetSpeeds | Stop | ClearEmergencyStop, now: int) -> Write:
        self._unanswered.append((line.sequence, now))
        self._sent_since_telemetry += 1
        self.last_sent = now
        return Write(self.robot, encode(line))

    def _acknowledged(self, line: Acknowledgement) -> None:
        if any(sequence == line.sequence for sequence, _ in self._unanswered):
            while self._unanswered.popleft()[0] != line.sequence:
                pass
            self._note(line.flags)

    def _note(self, flags: int) -> None:
        self.flags = flags
        self._may_clear = self._may_clear and self.can_clear

    def _measured(self, line: Telemetry, now: int) -> Measurement:
        last, self._telemetry = self._telemetry, line
        since = self._heard_at if self._heard_at is not None else now
        if now - since > self._silence:
            self._may_clear = False  # whether the button was pressed meanwhile, nobody can tell
        self._heard_at = self._silent_since = now
        self._sent_since_telemetry = 0
        self._note(line.flags)
        self.battery = line.battery / 1000.0
        offset = now - 1_000_000 * line.milliseconds
        if last is None or line.milliseconds < last.milliseconds or abs(offset - self._offset) > JUMP:
            # The first, or the robot was switched on again and counts from the start.
            self._offset = offset
            return Measurement(now, line.taken, 0, 0)
        # Lines come late by different times: the earliest tells most of the robot's clock.
        self._offset = min(self._offset + int(CLOCK_DRIFT * (now - since)), offset)
        stamp = min(self._offset + 1_000_000 * line.milliseconds, now)
        return Measurement(stamp, line.taken, _difference(line.left, last.left), _difference(line.right, last.right))


def _difference(ticks: int, before: int) -> int:
    return (ticks - before + 2**31) % 2**32 - 2**31
