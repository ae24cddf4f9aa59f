"""How games have ended since the console started."""

from __future__ import annotations

from schemas import Episode
from services.console.frames import frame

KEPT = 1000
"""Games that can be taken back later."""


class Score:
    """Counts each game once, as it stands now: a game that was discarded is not survived any more."""

    def __init__(self) -> None:
        self._games: dict[int, str] = {}
        self._counts = {"survived": 0, "caught": 0, "aborted": 0, "discarded": 0}
        self._steps: dict[int, int] = {}
        self._step_sum = 0
        self._on = 0  # number of the game that was set up or ran last

    def add(self, episode: Episode) -> None:
        """Take in what is said of a game. Its end counts once, and only where it was heard to be set up or to run.

        What the bus still held of a game that was over before (a latched message) does not count.
        """
        if episode.phase == "setup":
            self._begin(episode.episode)
        if episode.phase in ("setup", "running"):
            self._on = episode.episode
            return
        if episode.episode != self._on or episode.episode in self._games:
            return
        result = episode.outcome if episode.phase == "ended" else "aborted"
        if result not in self._counts:
            result = "aborted"
        self._count(episode.episode, result, 1)
        if episode.phase == "ended":
            self._steps[episode.episode] = episode.step
            self._step_sum += episode.step
        if len(self._games) > KEPT:
            oldest = next(iter(self._games))
            del self._games[oldest]
            # It stays counted: what is forgotten is how to take it back.
            self._steps.pop(oldest, None)

    def discard(self, number: int) -> None:
        """Take a game back, also one that is about to be aborted for it."""
        result = self._games.get(number)
        if result == "discarded":
            return
        if result is not None:
            self._counts[result] -= 1
        self._step_sum -= self._steps.pop(number, 0)
        self._count(number, "discarded", 1)

    def knows(self, number: int) -> bool:
        """Return whether the end of a game was heard, and it was not taken back."""
        return self._games.get(number, "discarded") != "discarded"

    def is_discarded(self, number: int) -> bool:
        """Return whether a game was taken back."""
        return self._games.get(number) == "discarded"

    def frame(self) -> bytes:
        """Return the frame `score`."""
        ended = self._counts["survived"] + self._counts["caught"]
        fields = {"games": sum(self._counts.values()), **self._counts, "mean_steps": self._step_sum / ended if ended else None}
        return frame("score", fields)

    def _begin(self, number: int) -> None:
        """A game is set up: an earlier one of its number (the referee began to count anew) stays as it is."""
        self._games.pop(number, None)
        self._steps.pop(number, None)

    def _count(self, number: int, result: str, change: int) -> None:
        self._games[number] = result
        self._counts[result] += change
