"""Why a game was given up: who is not there, and what is wrong with those who embody the robots."""

from __future__ import annotations

from collections.abc import Collection

from schemas import REASON_LIMIT, Health

SHARE = 110
"""Letters of a reason that one service's troubles may take."""


class Troubles:
    """What services last said of themselves.

    Args:
        required: services without which no game is played, `a|b`: one of the two.
    """

    def __init__(self, required: tuple[str, ...]) -> None:
        self._required = required
        self._said: dict[str, str] = {}

    def hear(self, health: Health) -> None:
        """Take in what a service says."""
        self._said[health.service] = health.reason

    def missing(self, alive: Collection[str]) -> list[str]:
        """Return which of the required services are not alive."""
        return [names for names in self._required if not any(name in alive for name in names.split("|"))]

    def blame(self, reason: str, alive: Collection[str]) -> str:
        """Return a reason with who is not alive, and what those who embody the robots last said: they owe the answer."""
        troubles = [f"{names.replace('|', ' or ')} is not alive" for names in self.missing(alive)]
        for service, trouble in self._said.items():
            if trouble and service in alive:
                said = f"{service}: {trouble}"
                troubles.append(said if len(said) <= SHARE else said[: SHARE - 3] + "...")
        return "; ".join([reason, *troubles])[:REASON_LIMIT]
