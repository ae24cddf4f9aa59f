"""The participant whose games are played: when it leaves the bus and does not come back, they end."""

from __future__ import annotations


class Owner:
    """Knows whether the owner of the games is there. All times in ns.

    A participant counts as gone when the bus has lost it for `grace`: a process that dies is seen at once, one that is stopped or
    cut off once its connection is closed (`vantage.bus.zenoh_session.LEASE`), and a connection that comes back within the grace
    ends nothing.
    """

    def __init__(self, grace: int) -> None:
        self._grace = grace
        self._name = ""
        self.gone_at: int | None = None
        """When the games end, unless the owner is back; None while it is there, or there is none."""

    def begin(self, name: str, present: bool, now: int) -> None:
        """Set the owner of the games; empty for none."""
        self._name = name
        self.gone_at = now + self._grace if name and not present else None

    def change(self, name: str, alive: bool, now: int) -> None:
        """Take note of a participant that came or went."""
        if name and name == self._name:
            self.gone_at = None if alive else now + self._grace

    def end(self) -> None:
        """Nobody's games are played any more."""
        self._name, self.gone_at = "", None
