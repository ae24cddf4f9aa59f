"""A core: what a service hears and says, and the events and messages that pass between it and the runtime."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from schemas import CALLS, TOPICS, Message
from vantage.bus import Lost, Sample
from vantage.errors import UserError
from vantage.service.device import Captured, Write

SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Declaration:
    """What a service hears and says. The runtime subscribes and checks by it, deployments are checked by it.

    Attributes:
        inputs, outputs: short keys of the topic table.
        calls, serves: keys of the call table.
        heeds: services that this one needs, whose coming and going the core wants to know (`Changed`); `a|b`: one of the two.
        watches: other participants whose coming and going it wants to know.
        audience: shows whatever there is: its inputs may lack a publisher in a deployment.
        raw: inputs are key expressions, and reach the core undecoded, as `vantage.bus.Sample` (the recorder).
    """

    name: str
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    calls: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()
    heeds: tuple[str, ...] = ()
    watches: tuple[str, ...] = ()
    audience: bool = False
    raw: bool = False

    @property
    def participants(self) -> tuple[str, ...]:
        """Everyone whose coming and going the core is told of."""
        return (*(name for names in self.heeds for name in names.split("|")), *self.watches)

    def __post_init__(self) -> None:
        named = self.outputs if self.raw else self.inputs + self.outputs
        undeclared = [key for key in named if key not in TOPICS] + [key for key in self.calls + self.serves if key not in CALLS]
        if undeclared:
            raise ValueError(f"{self.name}: not in the topic or call table: {', '.join(undeclared)}")


@dataclass(slots=True)
class Arrived:
    """A message came in; `published`: when, ns by the sender's clock, 0 where that is unknown (see `SenderClock`)."""

    key: str
    message: Message
    published: int = field(default=0, compare=False)


@dataclass(slots=True)
class Asked:
    """Somebody calls; answer with `Answer` or `Refuse` carrying the token."""

    key: str
    request: Message
    token: int


@dataclass(slots=True)
class Answered:
    """An `Ask` came back: a reply, or none and the reason."""

    key: str
    token: int
    reply: Message | None
    error: str = ""


@dataclass(slots=True)
class Changed:
    """A participant that is heeded or watched came or went."""

    service: str
    alive: bool


@dataclass(slots=True)
class Woken:
    """The time that `wake_at` named has come."""


Received = Arrived | Asked | Answered | Changed | Woken | Captured | Sample | Lost


@dataclass(slots=True)
class Publish:
    key: str
    message: Message


@dataclass(slots=True)
class Ask:
    """Call `key`; the `Answered` that follows carries the same token."""

    key: str
    request: Message
    timeout: float
    token: int


@dataclass(slots=True)
class Answer:
    token: int
    reply: Message


@dataclass(slots=True)
class Refuse:
    token: int
    reason: str


Send = Publish | Ask | Answer | Refuse | Write


class Unexpected(Exception):
    """Raised by a core for a well-formed message that makes no sense here: it is counted and set aside."""


class CannotStart(UserError):
    """Raised while a service is made: printed as one line, exit code 1."""


class Core(Protocol):
    """The behaviour of a service, without clock, bus or I/O.

    It may have `trouble`, a text that makes its health degraded while it is not empty; `close`, called at the end; and
    `held_up(lag, now)`, called before the next event when the service did not run for `lag` ns: whatever it waits for had that
    much less time to come.
    """

    @property
    def declaration(self) -> Declaration: ...

    def step(self, received: Received, now: int) -> Sequence[Send]:
        """React to one event. `now` in ns since the Unix epoch.

        Raises:
            Unexpected: the message makes no sense here.
            MalformedMessage: a raw core's own finding; it is counted as the runtime counts its own.
        """
        ...

    def wake_at(self) -> int | None:
        """Return the time (ns) at which the core wants `Woken`, or None."""
        ...
