"""What a page may ask: one JSON text message each, told apart by `type`; anything else is refused."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta, Struct

from schemas import FASTEST, GOAL_COUNT, SLOWEST, Primitive

MESSAGE_LIMIT = 4096
"""Bytes of a page's longest message."""
STEPS_LIMIT = 2000
GAMES_LIMIT = 1000
SHORTEST_PERIOD, LONGEST_PERIOD = 0.05, 10.0
"""Seconds a step, where a human drives; 0 is for planners only."""
PERSON_LIMIT = 80
"""Letters of a name or pseudonym."""
VIEWS_LIMIT = 64
"""Past views asked for at once."""

Layout = Literal["random", "lab"]
Seeker = Literal["glancing", "expert"]
LAYOUTS: tuple[str, ...] = get_args(Layout)
SEEKERS: tuple[str, ...] = get_args(Seeker)

Episode = Annotated[int, Meta(ge=0, le=2**53)]
Step = Annotated[int, Meta(ge=0, le=100_000)]
Positive = Annotated[float, Meta(ge=0.0, le=1e9)]


class Request(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag=str.lower):
    """What all requests share: `type`, the class's name in small letters."""


class Start(Request, frozen=True, kw_only=True):
    """Play games. Who asks for a human hider gets the wheel."""

    seed: Annotated[int, Meta(ge=0, le=2**53)] = 1
    games: Annotated[int, Meta(ge=0, le=GAMES_LIMIT, description="0: until stopped")] = 1
    steps: Annotated[int, Meta(ge=1, le=STEPS_LIMIT)] = 100
    layout: Layout = "random"
    hider: Literal["planner", "human"] = "planner"
    seeker: Seeker = "glancing"
    period: Annotated[float, Meta(ge=0.0, le=LONGEST_PERIOD, description="s a step; 0: as fast as the players answer")] = 0.25
    person: Annotated[str, Meta(max_length=PERSON_LIMIT, description="stored in the log if given")] = ""


class Stop(Request, frozen=True, kw_only=True):
    """End the game, and play no more."""


class Pause(Request, frozen=True, kw_only=True):
    """Hold the step clock, or a replay."""


class Resume(Request, frozen=True, kw_only=True):
    """Go on. In a human game without a driver, who asks gets the wheel."""

    speed: Annotated[float, Meta(ge=SLOWEST, le=FASTEST, description="of a replay")] | None = None


class Discard(Request, frozen=True, kw_only=True):
    """A game is not to be used as data."""

    episode: Episode


class Seek(Request, frozen=True, kw_only=True):
    """A replay goes on at another place."""

    position: Annotated[Positive, Meta(description="s after the log's first message")]


class Drive(Request, frozen=True, kw_only=True):
    """A key of the driver was pressed or let go."""

    primitive: Primitive
    held: bool


class Predict(Request, frozen=True, kw_only=True):
    """What would the seeker see on the way to this goal?"""

    goal: Annotated[int, Meta(ge=0, lt=GOAL_COUNT)]


class Views(Request, frozen=True, kw_only=True):
    """What the seeker saw at these steps."""

    episode: Episode
    steps: Annotated[tuple[Step, ...], Meta(max_length=VIEWS_LIMIT)]


AnyRequest = Start | Stop | Pause | Resume | Discard | Seek | Drive | Predict | Views

_decoder = msgspec.json.Decoder(AnyRequest)


class MalformedRequest(ValueError):
    """A page said something that is no request; the text says what is wrong with it."""


def decode_request(text: str) -> AnyRequest:
    """Return the request in a page's message.

    Raises:
        MalformedRequest: it is not JSON, of no known type, or a field is missing, unknown or out of bounds.
    """
    if len(text) > MESSAGE_LIMIT:
        raise MalformedRequest(f"a message of {len(text)} letters, at most {MESSAGE_LIMIT} are read")
    try:
        return _decoder.decode(text)
    except (msgspec.MsgspecError, UnicodeError, ValueError, OverflowError, RecursionError) as error:
        raise MalformedRequest(str(error)[:200]) from error
