"""Every message about the running of a table, declared once: health, people's wishes, replays, losses.

The conventions are those of `schemas.messages`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct, field

from schemas.messages import Count, LongText, Message, Players, Rules, Seconds, ShortText, require_finite

SLOWEST, FASTEST = 0.1, 100.0
"""Speeds of a replay."""


class InputHealth(Struct, frozen=True, kw_only=True):
    """One input of a service."""

    key: ShortText
    publisher: Annotated[ShortText, Meta(description="who published last, empty before the first message")] = ""
    received: Count = 0
    malformed: Annotated[Count, Meta(description="messages refused when decoded")] = 0
    lost: Annotated[Count, Meta(description="messages known to be missing")] = 0
    age: Annotated[Seconds | None, Meta(description="s since the last message; null before the first")] = None
    stale: Annotated[bool, Meta(description="older than its topic's rate allows")] = False


class Health(Message, frozen=True, kw_only=True):
    """What a service says of itself, once a second."""

    service: ShortText
    state: Literal["starting", "ok", "degraded", "stopping"]
    process: Annotated[Count, Meta(description="process id")]
    uptime: Annotated[Seconds, Meta(description="s since the service started")]
    inputs: Annotated[tuple[InputHealth, ...], Meta(max_length=256)] = ()
    unexpected: Annotated[Count, Meta(description="well-formed messages that made no sense here and were set aside")] = 0
    failed: Annotated[Count, Meta(description="messages whose handling raised an error")] = 0
    reason: Annotated[LongText, Meta(description="what is wrong, for people: topic, publisher, age, expected rate")] = ""

    def __post_init__(self) -> None:
        require_finite("health", self.uptime, *(i.age for i in self.inputs if i.age is not None))


class Control(Message, frozen=True, kw_only=True):
    """People's wishes: start games or stop them, hold the clock, take back a game, move about in a replayed log.

    The referee publishes one, too: it stops the games whose owner has left the bus.
    """

    action: Annotated[
        Literal["start", "stop", "pause", "resume", "discard", "seek"],
        Meta(
            description="start, stop: games; pause, resume: the step clock of a game, or a replay; discard: episode `episode` is "
            "not to be used as data; seek: a replay goes on at `position`"
        ),
    ]
    seed: Annotated[Count, Meta(description="start: seed of the first game; game n uses seed + n - 1")] = 1
    games: Annotated[Count, Meta(description="start: how many games; 0 = until stopped")] = 1
    rules: Rules = field(default_factory=Rules)
    players: Players = field(default_factory=Players)
    request: Annotated[
        ShortText,
        Meta(
            description="start: random name of these games, which carry it as `Episode.request`; the same request again starts "
            "nothing. stop: only the games of this request; empty: whatever is played"
        ),
    ] = ""
    owner: Annotated[
        ShortText, Meta(description="start: participant whose leaving the bus stops the games; empty: they go on without anyone")
    ] = ""
    reason: Annotated[ShortText, Meta(description="stop: why, for people")] = ""
    position: Annotated[Seconds, Meta(description="seek: s after the log's first message")] = 0.0
    speed: Annotated[
        Annotated[float, Meta(ge=SLOWEST, le=FASTEST)] | None,
        Meta(description="resume: a replay goes on so many times as fast as it was recorded; null: as before"),
    ] = None

    def __post_init__(self) -> None:
        require_finite("control", self.position, *(() if self.speed is None else (self.speed,)))


class Playback(Message, frozen=True, kw_only=True):
    """How the replay of a log stands. `stamp` is the log's clock; episode and step are those reached."""

    log: Annotated[ShortText, Meta(description="name of the log")]
    position: Annotated[Seconds, Meta(description="s after the log's first message")]
    duration: Annotated[Seconds, Meta(description="s from the log's first message to its last")]
    speed: Annotated[float, Meta(ge=SLOWEST, le=FASTEST, description="times as fast as it was recorded")] = 1.0
    state: Literal["playing", "paused", "ended"] = "playing"
    jumps: Annotated[Count, Meta(description="how often it went to another place: what is shown is to be forgotten then")] = 0

    def __post_init__(self) -> None:
        require_finite("playback", self.position, self.duration, self.speed)


class Gap(Message, frozen=True, kw_only=True):
    """The recorder's note that messages of a topic were lost."""

    key: ShortText
    publisher: ShortText
    missed: Annotated[Count, Meta(description="how many messages")]
