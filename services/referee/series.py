"""The games that were asked for: how many are left, by what rules, who plays, from which seed on."""

from __future__ import annotations

from typing import Any, Literal

from schemas import Control, Episode
from services.referee.settings import RefereeSettings

GamePhase = Literal["setup", "running", "ended", "aborted"]


class Series:
    """Games that follow one another. The first is numbered when it begins; each has the seed after the last one's.

    Attributes:
        left: games still to begin; None: without end.
        rules: of all its games.
        players: of all its games.
        request: name of what was asked for, which its games carry; empty: none.
    """

    def __init__(self, settings: RefereeSettings) -> None:
        self.left: int | None = (settings.games or None) if settings.autoplay else 0
        self.rules, self.players = settings.rules, settings.players
        self.request = ""
        self._seed = settings.seed  # of the first game
        self._first: int | None = settings.first_episode  # None: the next game is the first

    def ask(self, control: Control) -> None:
        """Take in what somebody wants to be played, instead of all that was asked for before."""
        self.left = control.games or None
        self.rules, self.players, self.request = control.rules, control.players, control.request
        self._seed, self._first = control.seed, None

    def stop(self) -> None:
        """No more games begin."""
        self.left = 0

    def begin(self, number: int) -> None:
        """The next game begins, as episode `number`."""
        if self.left is not None:
            self.left -= 1
        if self._first is None:
            self._first = number

    def seed(self, number: int) -> int:
        """Return the seed of episode `number`."""
        return self._seed + (0 if self._first is None else number - self._first)

    def episode(self, number: int, phase: GamePhase, **how: Any) -> Episode:
        """Return what is said of episode `number`: what was asked for, and how it stands."""
        return Episode(
            episode=number,
            seed=self.seed(number),
            phase=phase,
            rules=self.rules,
            players=self.players,
            request=self.request,
            **how,
        )
