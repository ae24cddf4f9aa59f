"""What the wheels will still do: speeds already sent act late and the wheels follow with a lag, so they coast."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from services.robot.settings import Wheels
from vantage.service import SECOND

UNEVEN_MEMORY = 0.05
"""Share that a line has in the running mean of how unevenly they come."""
TRUST = 0.5
"""Share by which a measured speed corrects the modelled one."""


@dataclass(slots=True)
class _Told:
    """Speeds (m/s) sent in a line, since a time (ns); over: the robot is known to have taken a later one."""

    sequence: int
    since: int
    left: float
    right: float
    over: bool = False


class WheelModel:
    """First-order wheels with a dead time, corrected by encoders and by which lines the robot says it has taken.

    A wheel of speed w that follows u with time constant lag turns by lag * w and the integral of what it is still told,
    until it rests. So what a command will have come to is known before it shows.
    """

    def __init__(self, wheels: Wheels) -> None:
        self._lag = wheels.lag
        self._dead_time = int(2.0 * wheels.line_latency * SECOND)  # stamps of measurements are of their arrival
        self._told: deque[_Told] = deque(maxlen=128)
        self._speeds = (0.0, 0.0)
        self._measured: int | None = None
        self._taken: int | None = None
        self._taken_at = 0
        self._excess_square = 0.0  # s^2, running mean
        self._acted_until = 0  # what was told until then has acted by the last measurement

    @property
    def told_to_rest(self) -> bool:
        """Whether the last line that the robot is known to have taken stops the wheels, and so does every later one."""
        return all(told.left == 0.0 == told.right for told in self._told if not told.over)

    @property
    def uneven(self) -> float:
        """By how much longer than meant speeds hold because lines come unevenly, root mean square, s."""
        return math.sqrt(self._excess_square)

    def tell(self, sequence: int, left: float, right: float, now: int) -> None:
        """Take note of speeds (m/s) sent at a time (ns) in the line of this number."""
        self._told.append(_Told(sequence, now, left, right))

    def measure(self, stamp: int, taken: int, left: float, right: float) -> None:
        """Take what the wheels turned (m) since the last measurement, up to a time (ns), and the last line taken by then."""
        since, self._measured = self._measured, stamp
        self._note_holding(stamp, taken)
        acted_since, self._acted_until = self._acted_until, self._acted(stamp, taken)
        if since is None or stamp <= since:
            return
        span = (stamp - since) / SECOND
        targets = self._mean_told(acted_since, self._acted_until)
        decay = math.exp(-span / self._lag) if self._lag > 0.0 else 0.0
        speeds = []
        for speed, target, turned in zip(self._speeds, targets, (left, right), strict=True):
            mean = target + (speed - target) * self._lag * (1.0 - decay) / span
            speeds.append(target + (speed - target) * decay + TRUST * (turned / span - mean))
        self._speeds = (speeds[0], speeds[1])

    def coast(self, now: int) -> tuple[float, float]:
        """Return how far (m) the left and right wheel will turn from the last measurement on, if told to stop now."""
        if self._measured is None:
            return 0.0, 0.0
        left, right = self._turned(self._acted_until, now)
        return left + self._lag * self._speeds[0], right + self._lag * self._speeds[1]

    def _note_holding(self, stamp: int, taken: int) -> None:
        """Compare how long the line taken before has held with how long it was meant to: until the one after it."""
        if taken == self._taken:
            return
        for index, told in enumerate(self._told):
            if told.sequence == self._taken and index + 1 < len(self._told):
                meant = self._told[index + 1].since - told.since
                excess = max(stamp - self._taken_at - meant, 0) / SECOND
                self._excess_square += UNEVEN_MEMORY * (excess * excess - self._excess_square)
                break
        self._taken, self._taken_at = taken, stamp

    def _acted(self, stamp: int, taken: int) -> int:
        """Return until when (ns) what was told has acted by a measurement: by the usual dead time, if the robot agrees."""
        until = max(stamp - self._dead_time, self._acted_until)
        for index in range(len(self._told) - 1, -1, -1):
            if self._told[index].sequence == taken:
                for before in range(index):
                    self._told[before].over = True
                until = max(until, self._told[index].since)
                return min(until, self._told[index + 1].since) if index + 1 < len(self._told) else until
        return until

    def _mean_told(self, since: int, until: int) -> tuple[float, float]:
        """Return the mean of the speeds told between two times, m/s."""
        if until <= since:
            told = [told for told in self._told if told.since <= until]
            return (told[-1].left, told[-1].right) if told else (0.0, 0.0)
        left, right = self._turned(since, until)
        return left * SECOND / (until - since), right * SECOND / (until - since)

    def _turned(self, since: int, until: int) -> tuple[float, float]:
        """Return the integral of what the wheels were told between two times, m."""
        left = right = 0.0
        end = until
        for told in reversed(self._told):
            span = (end - max(told.since, since)) / SECOND
            if span > 0.0:
                left += told.left * span
                right += told.right * span
                end = max(told.since, since)
            if told.since <= since:
                break
        return left, right
