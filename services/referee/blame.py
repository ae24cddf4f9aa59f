"""Why a game was given up: who is not there, and what is wrong with those who embody the robots."""

from __future__ import annotations

from collections.abc import Collection

from schemas import REASON_LIMIT, Health
from vantage.printable import shortened
from vantage.service import TOO_SLOW

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

    def change(self, service: str, alive: bool) -> None:
        """Forget the troubles of a service that went."""
        if not alive:
            self._said.pop(service, None)

    def missing(self, alive: Collection[str]) -> list[str]:
        """Return which of the required services are not alive."""
        return [names for names in self._required if not any(name in alive for name in names.split("|"))]

    def blame(self, reason: str, alive: Collection[str]) -> str:
        """Return a reason with who is not alive, and what those who embody the robots last said: they owe the answer."""
        troubles = [f"{names.replace('|', ' or ')} is not alive" for names in self.missing(alive)]
        said = {service: trouble for service, trouble in self._said.items() if trouble}
        told = [service for service, trouble in said.items() if service in alive or TOO_SLOW in trouble]
        told.sort(key=lambda service: TOO_SLOW not in said[service])
        troubles += [shortened(f"{service}: {said[service]}", SHARE) for service in told]
        return shortened("; ".join([reason, *troubles]), REASON_LIMIT)

    def too_slow(self) -> bool:
        """Return whether a service says that this machine is too slow for it."""
        return any(TOO_SLOW in trouble for trouble in self._said.values())
