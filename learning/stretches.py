"""Games whose numbers have gaps: seeds of a split that nothing was recorded for are left out of a collection."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from schemas import Episode
from services.referee.core import RefereeCore, RefereeSettings
from vantage.service import Changed, Publish, Received, Send


def stretches(numbers: Iterable[int]) -> list[range]:
    """Return ascending numbers as ranges without gaps."""
    found: list[range] = []
    for number in numbers:
        if found and found[-1].stop == number:
            found[-1] = range(found[-1].start, number + 1)
        else:
            found.append(range(number, number + 1))
    return found


class RefereeOfStretches:
    """A referee core that plays stretches of games, each with consecutive numbers and seeds, one after the other."""

    def __init__(self, settings: Sequence[RefereeSettings]) -> None:
        """Args:
        settings: of each stretch, which starts by itself; `games` of them, of the last perhaps without end.
        """
        self._waiting = list(settings)
        self._alive: set[str] = set()
        self._begin()
        self.declaration = self._referee.declaration

    def wake_at(self) -> int | None:
        return self._referee.wake_at()

    def step(self, received: Received, now: int) -> Sequence[Send]:
        if isinstance(received, Changed):
            (self._alive.add if received.alive else self._alive.discard)(received.service)
        sends = self._referee.step(received, now)
        over = [send for send in sends if isinstance(send, Publish) and isinstance(send.message, Episode)]
        self._left -= sum(send.message.phase in ("ended", "aborted") for send in over)  # type: ignore[attr-defined]
        if self._left == 0 and self._waiting:
            self._begin()
            for service in sorted(self._alive):
                self._referee.step(Changed(service, True), now)
        return sends

    def _begin(self) -> None:
        settings = self._waiting.pop(0)
        self._left = settings.games
        self._referee = RefereeCore(settings)
