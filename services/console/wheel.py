"""The wheel of a human's game: which page drives, and what is said to the bus for it, also where nobody does."""

from __future__ import annotations

from schemas import Control, Episode, Message
from services.console import requests
from services.console.human import HUMAN, Complete, HumanHider, Keys, answer
from services.console.wishes import Refused
from vantage.service import SECOND, Publish, Send

NOBODY = 0
GRACE = SECOND
"""ns in which a game of a human that nobody at our pages drives may turn out to be a replay, or somebody take the wheel."""


class Wheel:
    """Answers the steps of a human's game. Where nobody drives, the robot stays and the game is paused, once.

    Attributes:
        driver: client number of the page at the wheel, 0: nobody.
        pause_asked: whether a pause was asked for here that nobody took back and the referee has not confirmed.
    """

    def __init__(self) -> None:
        self.driver = NOBODY
        self.pause_asked = False
        self._keys = Keys()
        self._human = HumanHider()
        self._unanswered: Complete | None = None
        self._grace_until: int | None = None
        self._hold = False

    @property
    def in_game(self) -> bool:
        """Whether a game that a human drives is set up or running."""
        return self._human.episode is not None

    @property
    def driven(self) -> bool:
        """Whether a page drives."""
        return self.driver != NOBODY

    def take(self, client: int) -> None:
        """A page drives from now on (0: nobody does); nobody's keys stay pressed."""
        if client != self.driver:
            self.driver = client
            self._keys.let_go()

    def leave(self) -> None:
        """Nobody drives any more, and nobody is waited for."""
        self.take(NOBODY)
        self._grace_until = None

    def forget(self) -> None:
        """Forget the game: it is a log's."""
        self._human.forget()
        self._unanswered = None
        self.leave()

    def drive(self, client: int, asked: requests.Drive) -> bool:
        """A key of a page was pressed or let go; return whether the page has taken the wheel.

        Raises:
            Refused: another page has it.
        """
        if not self.in_game:
            return False
        taken = not self.driven
        if taken:
            self.take(client)
        if self.driver != client:
            raise Refused("somebody drives at another page")
        (self._keys.press if asked.held else self._keys.release)(asked.primitive)
        return taken

    def hear(self, control: Control) -> None:
        """Take in what somebody asked for, a page of ours or the command line."""
        if control.action == "resume":
            # In the set-up the referee confirms no pause: the next one without a driver has to be asked for again.
            self.pause_asked = False
        elif control.action in ("start", "stop"):
            self.pause_asked = False
            if control.action == "start" and control.players.hider != HUMAN:
                self.take(NOBODY)

    def see(self, episode: Episode, another: bool, now: int) -> None:
        """Take in what the referee says of a game; `another`: it is not the one it spoke of last."""
        if another:
            self.pause_asked = False
            # Without a driver of ours it may be a game in a log; a page that drove the last game goes on at once.
            self._grace_until = now + GRACE
        if episode.paused != self._hold or episode.phase == "setup":
            self._keys.forget_taps()
        self._hold = episode.paused
        if episode.paused:
            self.pause_asked = False
        self._complete(self._human.see(episode))

    def add(self, key: str, message: Message) -> None:
        """Take in a message of `human.HEARD`."""
        self._complete(self._human.add(key, message))

    def wake_at(self) -> int | None:
        """When somebody has to have taken the wheel; None where that is not waited for."""
        return self._grace_until if self.in_game and not self.driven else None

    def mind(self, now: int) -> list[Send]:
        """Answer the step that is open; and where nobody drives a human's game, stay and pause it."""
        if not self.in_game:
            self._unanswered = None
            return []
        if not self.driven and self._grace_until is not None:
            if now < self._grace_until:
                return []
            self._grace_until = None
        sends: list[Send] = []
        if self._unanswered is not None:
            complete, self._unanswered = self._unanswered, None
            sends += answer(complete, self._keys.take() if self.driven else "stay")
        if not self.driven and not self._hold and not self.pause_asked:
            self.pause_asked = True
            sends.append(Publish("control", Control(stamp=now, action="pause")))
        return sends

    def _complete(self, complete: Complete | None) -> None:
        if complete is not None:
            self._unanswered = complete
