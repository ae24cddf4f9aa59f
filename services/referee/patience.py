"""How long the referee waits for those who embody the robots: only time in which they are there and able to answer counts."""

from __future__ import annotations

from vantage.service import SECOND

SILENT = 2 * SECOND
"""ns without its health message, due each second, after which a service is stopped, or starved by a busy machine."""


class Patience:
    """When the answer that is waited for is overdue. All times in ns.

    Args:
        outage: how long a service that is away, or silent, is waited for.
    """

    def __init__(self, outage: int) -> None:
        self._outage = outage
        self._heard: dict[str, int] = {}
        self._able_since = 0
        self._limit = 0

    def begin(self, now: int) -> None:
        """An answer is waited for from now on."""
        self._limit = now + self._outage

    def held_up(self, lag: int) -> None:
        """Do not count `lag` ns in which the referee itself did not run."""
        self._limit += lag
        self._able_since += lag
        self._heard = {service: heard + lag for service, heard in self._heard.items()}

    def hear(self, service: str, now: int) -> None:
        """Take note of a health message."""
        before = self._heard.get(service)
        self._heard[service] = now
        if before is not None and now - before > SILENT:
            self._able_since = now

    def change(self, service: str, alive: bool, now: int) -> None:
        """Take note of a service that came or went."""
        self._heard.pop(service, None)
        if alive:
            self._able_since = now

    def overdue_at(self, patience: int, complete: bool, now: int) -> int:
        """Return when to give up: `now` or earlier, that is now.

        Args:
            patience: for an answer of services that are able to give it.
            complete: every required service is alive.
        """
        if now >= self._limit:
            return now
        if not complete or any(now - heard > SILENT for heard in self._heard.values()):
            return min(now + SECOND // 2, self._limit)
        return min(self._able_since + patience, self._limit)
