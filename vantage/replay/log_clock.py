"""The log's clock against the real one."""

from __future__ import annotations

import math


class LogClock:
    """Maps real time to the time of a log; all times in ns, `now` never goes back.

    Args:
        at: log time at which it stands.
        speed: log seconds a real second.
    """

    def __init__(self, at: int, speed: float = 1.0) -> None:
        self._at = at
        self._since: int | None = None  # real time at which it ran on from `at`; None: it stands
        self.speed = speed

    @property
    def running(self) -> bool:
        return self._since is not None

    def time(self, now: int) -> int:
        """Return the log time; before `now` comes to where it was told to run, it stands."""
        return self._at if self._since is None else self._at + int(max(0, now - self._since) * self.speed)

    def set(self, at: int, now: int) -> None:
        """Stand at, or run on from, another log time."""
        self._at = at
        if self._since is not None:
            self._since = now

    def run(self, now: int) -> None:
        """Run from `now` on, which may lie ahead."""
        if self._since is None:
            self._since = now

    def stop(self, now: int) -> None:
        """Stand where it is."""
        self._at, self._since = self.time(now), None

    def set_speed(self, speed: float, now: int) -> None:
        """Go on from here at another speed."""
        self.set(self.time(now), now)
        self.speed = speed

    def reached_at(self, log_time: int) -> int | None:
        """Return the real time at which a log time is reached; None while the clock stands."""
        return None if self._since is None else self._since + math.ceil(max(0, log_time - self._at) / self.speed)
