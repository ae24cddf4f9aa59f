"""How the games that were asked for go."""

from __future__ import annotations

from typing import Any

from schemas import Control, Episode
from services.console.frames import frame


class Session:
    """The games asked for last.

    Attributes:
        hold: whether the game is paused: the referee's word.
        pausing: whether a pause was asked for that nobody took back.
    """

    def __init__(self) -> None:
        self.hold = False
        self.pausing = False
        self._asked = False
        self._request = ""  # name of what was asked for last
        self._wanted = 0
        self._played = 0
        self._on = 0  # number of the game that is set up or running
        self._over = 0  # number of the last game that is not to be counted again
        self._set_up_at = 0  # stamp of the last set-up, ns
        self._referee: int | None = None  # its process
        self._waits = False  # the referee says of a game that is over that another one waits for `resume`
        self._last: dict[str, Any] | None = None

    @property
    def more_games(self) -> bool:
        """Whether games are still to come, after the one that is on."""
        if self._waits:
            return True
        begun = self._played + (self._on not in (0, self._over))
        return self._asked and (self._wanted == 0 or begun < self._wanted)

    @property
    def paused(self) -> bool:
        """Whether there is a pause that can be taken back."""
        return self.hold or self.pausing

    def hear(self, control: Control) -> None:
        """Take in what somebody asked for, a page of ours or the command line."""
        if control.action in ("pause", "resume"):
            self.pausing = control.action == "pause"
            # Between games the referee does not answer it.
            self.hold = self.hold and (self.pausing or not self._waits)
        elif control.action in ("start", "stop"):
            if self._is_idle_talk(control):
                return
            self._request = control.request
            self.pausing = self._waits = False
            self._asked, self._wanted, self._played = control.action == "start", control.games, 0
            self._over = self._on  # is aborted for this, and is none of these games
        elif control.action == "discard" and self._last is not None and self._last["episode"] == control.episode:
            self._last["discarded"] = True

    def _is_idle_talk(self, control: Control) -> bool:
        """Return whether the referee does nothing on a wish: a start that it knows, or a stop of games that are not played."""
        if control.action == "start":
            return control.request != "" and control.request == self._request
        return control.request not in ("", self._request)

    def see(self, episode: Episode, discarded: bool) -> None:
        """Take in what the referee says of a game."""
        self.hold = episode.paused
        over = episode.phase in ("ended", "aborted")
        self._waits = over and episode.paused
        self._on = 0 if over else episode.episode
        if over:
            if episode.episode != self._over:
                self._over = episode.episode
                self._played += 1
            if episode.phase == "aborted" and episode.stamp == self._set_up_at:
                self._asked = False  # set up only to be given up, for want of a driver: the next ones are not tried
            self._last = {"episode": episode.episode, "discarded": discarded}
        elif episode.phase == "setup":
            self._over, self._set_up_at = 0, episode.stamp

    def hear_referee(self, process: int) -> bool:
        """Take in which process the referee is; return whether it was restarted: it knows of no games asked for, of no pause."""
        restarted = self._referee not in (None, process)
        if restarted:
            self._asked = self._waits = self.hold = self.pausing = False
            self._request = ""
        self._referee = process
        return restarted

    def frame(self, driver: int) -> bytes:
        """Return the frame `session`; `driver`: client number of the page at the wheel, 0: nobody."""
        fields = {"driver": driver, "more_games": self.more_games, "paused": self.paused, "last": self._last}
        return frame("session", fields)
