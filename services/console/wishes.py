"""What pages ask for, as messages to the referee or to a replay; or why not."""

from __future__ import annotations

from dataclasses import dataclass

from schemas import Control, Players, Rules
from services.console import requests
from services.console.human import HUMAN
from services.console.requests import SHORTEST_PERIOD, Start
from vantage.service import Unexpected


class Refused(Exception):
    """A page's wish cannot be granted; the text says why."""

    def __init__(self, text: str, level: str = "warning") -> None:
        super().__init__(text)
        self.level = level


@dataclass(frozen=True, slots=True)
class Situation:
    """What decides whether a wish makes sense.

    Attributes:
        replayed: a log is played on the bus.
        driven_elsewhere: another page is at the wheel of a game, or of the next one.
        can_pause: a game is on, or others follow.
        paused: a pause can be taken back.
        can_discard: the game that is to be taken back is on, or is over and was not taken back yet.
    """

    replayed: bool
    driven_elsewhere: bool
    can_pause: bool
    paused: bool
    can_discard: bool


def control_for(request: requests.AnyRequest, situation: Situation, now: int) -> Control:
    """Return the message to `control` for a page's wish, stamped `now` (ns).

    Raises:
        Refused: the wish makes no sense as things stand.
        Unexpected: the request is none for `control`.
    """
    match request:
        case requests.Start() | requests.Stop() | requests.Discard() if situation.replayed:
            raise Refused("this is the replay of a log: no game is played, none can be taken back")
        case requests.Start():
            if situation.driven_elsewhere:
                raise Refused("somebody is playing at another page: that game has to end first")
            return start(request, now)
        case requests.Stop() | requests.Discard() if situation.driven_elsewhere and not situation.paused:
            raise Refused("somebody is playing at another page: pause that game first")
        case requests.Stop():
            return Control(stamp=now, action="stop")
        case requests.Pause():
            if not (situation.replayed or situation.can_pause):
                raise Refused("there is nothing to pause")
            return Control(stamp=now, action="pause")
        case requests.Resume(speed=speed):
            if not (situation.replayed or situation.paused):
                raise Refused("nothing is paused")
            return Control(stamp=now, action="resume", speed=speed)
        case requests.Discard(episode=number):
            if not situation.can_discard:
                raise Refused(f"there is no game {number} that could be taken back")
            return Control(stamp=now, action="discard", episode=number)
        case requests.Seek(position=position):
            if not situation.replayed:
                raise Refused("this is no replay: a game cannot be wound back")
            return Control(stamp=now, action="seek", position=position)
    raise Unexpected(f"a request of type {type(request).__name__}")


def start(asked: Start, now: int) -> Control:
    """Return the request for games. Raises Refused where it makes no sense."""
    human = asked.hider == HUMAN
    if human and asked.period < SHORTEST_PERIOD:
        raise Refused(f"a step of {asked.period:g} s is too short for a human: {SHORTEST_PERIOD:g} s at least", "error")
    return Control(
        stamp=now,
        action="start",
        seed=asked.seed,
        games=asked.games,
        rules=Rules(maximum_steps=asked.steps, layout=asked.layout, step_period=asked.period),
        players=Players(hider=asked.hider, seeker=asked.seeker, person=_plain(asked.person) if human else ""),
    )


def _plain(name: str) -> str:
    """A name as one line of what can be printed: it is shown in terminals."""
    return " ".join("".join(letter if letter.isprintable() else " " for letter in name).split())
