"""Who is at the wheel, and how the games that were asked for go."""

from __future__ import annotations

from typing import Any

from schemas import Control, Episode
from services.console.frames import frame
from services.console.human import HUMAN, Keys

NOBODY = 0


class Session:
    """The games asked for last, and the page that drives in them.

    Attributes:
        driver: client number of the page at the wheel, 0: nobody.
        hold: whether the running game is paused.
        pausing: whether a pause was asked for that nobody took back.
    """

    def __init__(self) -> None:
        self.driver = NOBODY
        self.keys = Keys()
        self.hold = False
        self.pausing = False
        self._human = False
        self._person = ""
        self._asked = False
        self._wanted = 0
        self._played = 0
        self._over = 0  # number of the last game counted
        self._last: dict[str, Any] | None = None

    def take_wheel(self, client: int) -> None:
        """A page drives from now on (0: nobody does); nobody's keys stay pressed."""
        if client != self.driver:
            self.driver = client
            self.keys.let_go()

    @property
    def more_games(self) -> bool:
        """Whether games are still to come."""
        return self._asked and (self._wanted == 0 or self._played < self._wanted)

    def hear(self, control: Control) -> None:
        """Take in what somebody asked for, a page of ours or the command line."""
        if control.action in ("pause", "resume"):
            self.pausing = control.action == "pause"
        elif control.action == "start":
            self.pausing = False
            self._asked, self._wanted, self._played = True, control.games, 0
            self._human = control.players.hider == HUMAN
            self._person = control.players.person
            if not self._human:
                self.take_wheel(NOBODY)
        elif control.action == "stop":
            self.pausing = False
            self._asked = False
        elif control.action == "discard" and self._last is not None and self._last["episode"] == control.episode:
            self._last["discarded"] = True

    def see(self, episode: Episode, discarded: bool) -> None:
        """Take in what the referee says of a game."""
        if episode.paused != self.hold:
            self.keys.forget_taps()
        self.hold = episode.paused
        self._human = episode.players.hider == HUMAN
        self._person = episode.players.person
        if episode.phase in ("ended", "aborted"):
            if episode.episode != self._over:
                self._over = episode.episode
                self._played += 1
            outcome = episode.outcome if episode.phase == "ended" else "aborted"
            self._last = {"episode": episode.episode, "outcome": outcome, "steps": episode.step, "discarded": discarded}
        elif episode.phase == "setup":
            self._over = 0
            self.keys.forget_taps()

    def frame(self) -> bytes:
        """Return the frame `session`."""
        fields = {
            "driver": self.driver,
            "human": self._human,
            "person": self._person,
            "games_played": self._played,
            "games_wanted": self._wanted,
            "hold": self.hold,
            "last": self._last,
        }
        return frame("session", fields)
