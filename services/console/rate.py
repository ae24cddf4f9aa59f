"""How often something may happen."""

from __future__ import annotations


class Rate:
    """A bucket of `burst` pieces that fills with `per_second`; each event takes one."""

    def __init__(self, per_second: float, burst: float) -> None:
        self._per_second, self._burst = per_second, burst
        self._level = burst
        self._at: float | None = None

    def take(self, now: float) -> bool:
        """Return whether an event may happen at `now`, s."""
        if self._at is not None:
            self._level = min(self._burst, self._level + max(0.0, now - self._at) * self._per_second)
        self._at = now
        if self._level < 1.0:
            return False
        self._level -= 1.0
        return True
