"""The firmware of an emulated robot: answers the line protocol, watches over it, and loses lines as a bad cable does."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import tau

import numpy as np
import numpy.typing as npt

from vantage.drive.protocol import (
    BUTTON,
    EMERGENCY_STOP,
    LOW_BATTERY,
    SEQUENCES,
    TELEMETRY_RATE,
    WATCHDOG,
    WATCHDOG_STOP,
    Acknowledgement,
    ClearEmergencyStop,
    EmergencyStop,
    FromRobot,
    LineReader,
    Query,
    SetSpeeds,
    Stop,
    Telemetry,
    ToRobot,
    encode,
)
from vantage.rehearsal.body import Body

_SECOND = 1_000_000_000
TICK = 4_000_000
"""ns between two turns of the firmware's loop."""


@dataclass(frozen=True)
class FirmwareSettings:
    """The emulated electronics and their cable."""

    ticks_per_turn: int = 1440
    """encoder ticks of one turn of a wheel"""
    latency: float = 0.004
    """s that a line takes, each way"""
    jitter: float = 0.003
    """s more, at most, drawn for each line"""
    dropped: float = 0.01
    """share of the lines lost, each way"""
    damaged: float = 0.0
    """share of the lines with one byte changed, each way"""
    full: float = 8.3
    """V of the full battery"""
    empty: float = 6.4
    """V at or below which the battery is low"""
    drain: float = 2e-5
    """V/s at rest"""
    drain_moving: float = 2e-4
    """V/s more while the wheels turn"""


class Firmware:
    """See module. `feed` it what the driver writes, `advance` it to get what it writes back.

    Attributes:
        body: the robot's body, moved by `advance`.
        button: whether somebody presses the emergency stop button.
        powered: False: switched off; it neither answers nor moves.
        battery: V.
        refused: damaged lines received.
    """

    def __init__(self, body: Body, settings: FirmwareSettings | None = None, seed: int = 0) -> None:
        self.body = body
        self.settings = settings or FirmwareSettings()
        self.button = False
        self.powered = True
        self.battery = self.settings.full
        self._generator = np.random.default_rng(seed)  # of the cable
        self._slips = np.random.default_rng((seed, 1))
        self._reader = LineReader()
        self._partial = b""
        self._coming: deque[tuple[int, bytes]] = deque()
        self._going: deque[tuple[int, bytes]] = deque()
        self._started: int | None = None
        self._now = self._heard = self._next_telemetry = 0
        self._speeds = (0.0, 0.0)
        self._flags = 0
        self._taken = 0
        self._sequence = 0

    @property
    def refused(self) -> int:
        return self._reader.damaged

    @property
    def flags(self) -> int:
        """What telemetry says now."""
        low = LOW_BATTERY if self.battery <= self.settings.empty else 0
        return self._flags | low | (BUTTON if self.button else 0)

    def feed(self, data: bytes, now: int) -> None:
        """Take what the driver wrote at `now` (ns). Lines arrive later, or not at all."""
        *lines, self._partial = (self._partial + data).split(b"\n")
        for line in lines:
            self._travel(self._coming, line + b"\n", now)

    def advance(self, now: int, boxes: npt.NDArray[np.float64], other: tuple[float, float] | None) -> bytes:
        """Let time pass up to `now` (ns); return what has reached the driver by then.

        boxes float64 [n, 7]; `other`: the other robot's centre, m.
        """
        if self._started is None:
            self._now = self._started = self._heard = self._next_telemetry = now
        while self._now < now:
            until = min(self._now + TICK, now)
            self._tick((until - self._now) / _SECOND, until, boxes, other)
            self._now = until
        arrived = b""
        while self._going and self._going[0][0] <= now:
            arrived += self._going.popleft()[1]
        return arrived

    def _tick(self, dt: float, now: int, boxes: npt.NDArray[np.float64], other: tuple[float, float] | None) -> None:
        while self._coming and self._coming[0][0] <= now:
            data = self._coming.popleft()[1]
            for line in self._reader.feed(data):
                if self.powered and not isinstance(line, FromRobot):
                    self._obey(line, now)
        if self.button:
            self._flags |= EMERGENCY_STOP
        if now - self._heard > WATCHDOG * _SECOND and self._speeds != (0.0, 0.0):
            self._speeds = (0.0, 0.0)
            self._flags |= WATCHDOG_STOP
        if not self.powered or self._flags & EMERGENCY_STOP:
            self._speeds = (0.0, 0.0)
        self.body.step(dt, *self._speeds, boxes, other, self._slips)
        moving = self._speeds != (0.0, 0.0)
        self.battery -= dt * (self.settings.drain + (self.settings.drain_moving if moving else 0.0))
        while now >= self._next_telemetry:
            self._next_telemetry += int(_SECOND / TELEMETRY_RATE)
            if self.powered:
                self._measure(now)

    def _obey(self, line: ToRobot, now: int) -> None:
        if isinstance(line, SetSpeeds):
            self._speeds = (0.0, 0.0) if self._flags & EMERGENCY_STOP else (line.left / 1000.0, line.right / 1000.0)
        elif isinstance(line, Stop | EmergencyStop):
            self._speeds = (0.0, 0.0)
        if isinstance(line, EmergencyStop):
            self._flags |= EMERGENCY_STOP
        elif isinstance(line, ClearEmergencyStop) and not self.button:
            self._flags &= ~EMERGENCY_STOP
        if not isinstance(line, Query):
            self._heard = now
            self._flags &= ~WATCHDOG_STOP
        self._taken = line.sequence
        self._say(Acknowledgement(line.sequence, self.flags), now)

    def _measure(self, now: int) -> None:
        ticks_per_metre = self.settings.ticks_per_turn / (tau * self.body.settings.wheel_radius)
        left, right = (
            (int(metres * ticks_per_metre // 1) + 2**31) % 2**32 - 2**31 for metres in (self.body.left, self.body.right)
        )
        milliseconds = (now - (self._started or 0)) // 1_000_000 % 2**32
        battery = max(0, round(1000.0 * self.battery))
        self._say(Telemetry(self._sequence, milliseconds, self._taken, left, right, battery, self.flags), now)
        self._sequence = (self._sequence + 1) % SEQUENCES

    def _say(self, line: FromRobot, now: int) -> None:
        self._travel(self._going, encode(line), now)

    def _travel(self, way: deque[tuple[int, bytes]], line: bytes, now: int) -> None:
        """Put a line on its way: lines keep their order, arrive late, and some never."""
        lost, harmed, late, where = self._generator.random(4)
        if lost < self.settings.dropped:
            return
        if harmed < self.settings.damaged:
            place = int(where * (len(line) - 1))
            line = line[:place] + bytes([line[place] ^ 0x04]) + line[place + 1 :]
        arrival = now + int(_SECOND * (self.settings.latency + late * self.settings.jitter))
        if way:
            arrival = max(arrival, way[-1][0])
        way.append((arrival, line))
