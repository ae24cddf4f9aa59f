"""What the wheels will still do: speeds already sent act late and the wheels follow with a lag, so they coast."""

from __future__ import annotations

import math
from collections import deque

from services.robot.settings import Wheels

_SECOND = 1_000_000_000
TRUST = 0.5
"""Share by which a measured speed corrects the modelled one."""


class WheelModel:
    """First-order wheels with a dead time, corrected by encoders.

    A wheel of speed w that follows u with time constant lag turns by lag * w and the integral of what it is still told,
    until it rests. So what a command will have come to is known before it shows.
    """

    def __init__(self, wheels: Wheels) -> None:
        self._lag = wheels.lag
        self._dead_time = int(2.0 * wheels.line_latency * _SECOND)  # stamps of measurements are of their arrival
        self._told: deque[tuple[int, float, float]] = deque(maxlen=64)  # since when, left and right m/s
        self._speeds = (0.0, 0.0)
        self._measured: int | None = None

    def tell(self, now: int, left: float, right: float) -> None:
        """Take note of speeds (m/s) sent at a time (ns)."""
        self._told.append((now, left, right))

    def measure(self, stamp: int, left: float, right: float) -> None:
        """Take what the wheels turned (m) since the last measurement, up to a time (ns)."""
        since, self._measured = self._measured, stamp
        if since is None or stamp <= since:
            return
        span = (stamp - since) / _SECOND
        told = self._turned(since - self._dead_time, stamp - self._dead_time)
        decay = math.exp(-span / self._lag) if self._lag > 0.0 else 0.0
        speeds = []
        for speed, integral, turned in zip(self._speeds, told, (left, right), strict=True):
            target = integral / span
            mean = target + (speed - target) * self._lag * (1.0 - decay) / span
            speeds.append(target + (speed - target) * decay + TRUST * (turned / span - mean))
        self._speeds = (speeds[0], speeds[1])

    def coast(self, now: int) -> tuple[float, float]:
        """Return how far (m) the left and right wheel will turn from the last measurement on, if told to stop now."""
        if self._measured is None:
            return 0.0, 0.0
        left, right = self._turned(self._measured - self._dead_time, now)
        return left + self._lag * self._speeds[0], right + self._lag * self._speeds[1]

    def _turned(self, since: int, until: int) -> tuple[float, float]:
        """Return the integral of what the wheels were told between two times, m."""
        left = right = 0.0
        end = until
        for start, told_left, told_right in reversed(self._told):
            span = (end - max(start, since)) / _SECOND
            if span > 0.0:
                left += told_left * span
                right += told_right * span
                end = max(start, since)
            if start <= since:
                break
        return left, right
