"""Who is to drive the hider, and whether anybody does."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from schemas import REASON_LIMIT
from vantage.printable import shortened

PLANNER, HUMAN = "planner", "human"
"""Drivers of the hider (`players.hider`) that a deployment has; any other name is a row of the table of the service `hider`."""


class HiderDrivers:
    """Knows whether somebody can drive the hider of a game.

    The planner is a matter of the required services. The console is required by no game of the planner, so that its health is
    listened to instead: whoever has not said anything for `patience` ns is not there.

    Args:
        required: services without which no game begins, `a|b`: one of the two.
    """

    def __init__(self, required: Iterable[str], patience: int) -> None:
        self._required = {name for names in required for name in names.split("|")}
        self._patience = patience
        self._heard: int | None = None

    def hear_console(self, now: int) -> None:
        """Note that the console is alive."""
        self._heard = now

    def lacking(self, hider: str, alive: Collection[str], now: int) -> str:
        """Return why nobody drives the hider `hider` at `now` (ns), at most 200 letters; empty when somebody does."""
        if hider == HUMAN:
            heard = self._heard is not None and now - self._heard <= self._patience
            return "" if heard or "console" in alive else "a human is to drive the hider, but no console is alive"
        if hider == PLANNER or "hider" in self._required:
            return ""
        return shortened(f"nobody drives the hider `{hider}`; there are: {PLANNER}, {HUMAN}", REASON_LIMIT)

    def may_come(self, hider: str) -> bool:
        """Return whether it is worth while to wait for the driver."""
        return hider == HUMAN
