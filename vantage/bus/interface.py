"""The bus as a service sees it: one participant's session, and the events it receives.

A session is pull-based: whatever happens (a message, an answer, a participant that dies) is an event, and `Bus.receive` hands
out events in order of arrival, on the caller's thread. Keys are the short keys of `schemas.topics`; the arena's prefix is added
and taken off by the implementation.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from msgspec import Struct

from schemas import CALLS, TOPICS, Call, MalformedMessage, Message, Topic, decode, encode
from vantage.bus.expressions import named_keys
from vantage.errors import UserError

_PLAIN = re.compile(r"[A-Za-z0-9_.-]+", re.ASCII)
NAME_LIMIT = 64
"""Longest name of a participant, letters."""


class Refused(ValueError):
    """The bus does not do what was asked, because the tables of `schemas` do not allow it."""


class UnusableName(UserError, ValueError):
    """The name of an arena or of a participant cannot be part of a key; the text says what it must be."""


class UndeclaredKey(Refused):
    """The key is not in the table of topics (or of calls)."""


class WrongType(Refused):
    """The message is not of the type its key is declared with."""


class NotPublisher(Refused):
    """This participant may not publish the key, or not serve the call."""


class CannotOpen(UserError, RuntimeError):
    """The session cannot be opened; the text says why and what to do."""


class NameInUse(CannotOpen):
    """A living participant of the same name is on the bus."""


class CallFailed(RuntimeError):
    """A call ended without an answer; the text says why."""


class Sample(Struct, eq=False):
    """One message of a topic. (A msgspec Struct because nothing else is made as fast.)

    Attributes:
        key: short key.
        publisher: name of the participant that published it, empty when a stranger did.
        sequence: number of the message among those its publisher published on this key since it started, from 0.
        published: when it was published, ns since the Unix epoch (the network's clock when in-process). One clock for all
            publishers of this machine, which does not step when the wall clock is set; for the record, it orders nothing.
    """

    key: str
    _payload: bytes | None
    publisher: str
    sequence: int
    published: int
    _kind: type[Message] | None = None
    _message: Message | None = None
    _sent: int = 0

    @property
    def sent(self) -> int:
        """When it was published by the publisher's own clock, ns: comparable with the stamps that it wrote into its messages."""
        return self._sent or self.published

    @property
    def payload(self) -> bytes:
        """The bytes of the message as they travel; in-process they are made when first asked for."""
        if self._payload is None:
            assert self._message is not None
            self._payload = encode(self._message)
        return self._payload

    def decode(self) -> Message:
        """Return the message.

        Raises:
            MalformedMessage: the bytes are not a valid message of the key's type, or the key is in no table.
        """
        if self._message is None:
            if self._kind is None:
                raise MalformedMessage(f"`{self.key}` is not a declared topic, so its messages have no known type")
            self._message = decode(self._kind, self.payload)
        return self._message

    def __repr__(self) -> str:
        return f"Sample({self.key!r}, publisher={self.publisher!r}, sequence={self.sequence}, published={self.published})"


@dataclass(slots=True, frozen=True)
class Lost:
    """Messages of a lossless topic that can no longer be had (the publisher's cache was too small, or this queue full)."""

    key: str
    publisher: str
    missed: int


class Request(ABC):
    """A question to this participant. Answer it once, now or later, by `reply` or `fail`.

    A request that is dropped unanswered (its last reference goes) ends as a failed call at the caller.
    """

    __slots__ = ("answered", "call", "caller", "key", "payload", "token")

    def __init__(self, call: Call, payload: bytes, caller: str, token: int) -> None:
        self.call = call
        self.key = call.key
        self.payload = payload
        self.caller = caller
        self.token = token
        self.answered = False

    def decode(self) -> Message:
        """Return the request's message. Raises MalformedMessage when it is none of the declared type."""
        return decode(self.call.request, self.payload)

    def reply(self, message: Message) -> None:
        """Answer. Raises WrongType when the message is not of the call's declared reply type; does nothing the second time."""
        if type(message) is not self.call.reply:
            raise WrongType(f"`{self.key}` is answered by {self.call.reply.__name__}, not {type(message).__name__}")
        if not self.answered:
            self.answered = True
            self._send(encode(message), "")

    def fail(self, text: str) -> None:
        """Refuse, with the reason for the caller. Does nothing once the request is answered."""
        if not self.answered:
            self.answered = True
            self._send(None, text or "the server gave no reason")

    @abstractmethod
    def _send(self, payload: bytes | None, error: str) -> None: ...


class Reply:
    """How a call of this participant ended: with an answer, or with an error text. Exactly one comes for each call."""

    __slots__ = ("_kind", "error", "key", "payload", "token")

    def __init__(self, token: int, key: str, payload: bytes | None, error: str, kind: type[Message]) -> None:
        self.token = token
        self.key = key
        self.payload = payload
        self.error = error
        self._kind = kind

    def decode(self) -> Message:
        """Return the answer.

        Raises:
            CallFailed: there is none; the text is `error`.
            MalformedMessage: the server's bytes are no valid message of the declared type.
        """
        if self.payload is None:
            raise CallFailed(self.error)
        return decode(self._kind, self.payload)

    def __repr__(self) -> str:
        return f"Reply({self.token}, {self.key!r}, {'answered' if self.payload is not None else repr(self.error)})"


@dataclass(slots=True, frozen=True)
class Alive:
    """A participant came (`alive`) or went."""

    name: str
    alive: bool


Event = Sample | Lost | Request | Reply | Alive


class Bus(ABC):
    """One participant's session. Close it, or use it as a context manager; it belongs to one thread, but for `wake`.

    Args of every implementation:
        name: this participant; what it may publish and serve follows from the tables.
        topics, calls: the tables; the project's own unless a test brings others.
    """

    def __init__(self, name: str, arena: str, topics: Mapping[str, Topic] = TOPICS, calls: Mapping[str, Call] = CALLS) -> None:
        for word, text in (("name", name), ("arena", arena)):
            if not _PLAIN.fullmatch(text) or len(text) > NAME_LIMIT:
                raise UnusableName(
                    f"{word} {text!r} must be one word of at most {NAME_LIMIT} letters, digits, `-`, `_` and `.`: choose another"
                )
        self.name = name
        self.arena = arena
        self._topics = topics
        self._calls = calls

    @abstractmethod
    def publish(self, key: str, message: Message) -> None:
        """Publish on a declared key, without ever waiting for a slow reader.

        Raises:
            UndeclaredKey, WrongType, NotPublisher: the table of topics does not allow it.
        """

    @abstractmethod
    def subscribe(self, *expressions: str, raw: bool = False) -> None:
        """Receive Sample (and Lost) events of the declared topics that the keys or expressions name, this session's own included.

        A late joiner gets the topic's last `history` messages first. Of a topic with `latest` delivery only the newest unread
        message is kept. Topics subscribed already are left as they are.

        Args:
            raw: as the recorder needs it: every message, also those of `latest` topics, and also what strangers publish
                under the arena on keys that no table declares; a late joiner gets all that the publishers' caches still hold.

        Raises:
            UndeclaredKey: nothing declared is named (unless raw).
            ValueError: not a key expression.
        """

    @abstractmethod
    def receive(self, timeout: float) -> Event | Any | None:
        """Return the next event, posted ones included, in order of arrival; None when none came within `timeout` seconds, or
        after `wake`.

        In-process nothing can arrive while the one thread waits, so it returns at once.
        """

    @abstractmethod
    def call(self, key: str, request: Message, timeout: float) -> int:
        """Ask the call's server; return a token at once. One Reply event with it follows, at the latest after `timeout` s.

        Raises:
            UndeclaredKey, WrongType: the table of calls does not allow it.
        """

    @abstractmethod
    def serve(self, key: str) -> None:
        """Answer a call from now on: questions come as Request events.

        Raises:
            UndeclaredKey, NotPublisher: the table of calls does not name this participant as the key's server.
        """

    @abstractmethod
    def watch(self) -> None:
        """Receive an Alive event for every participant on the bus, those already there and this one included, now and later.

        A participant counts as there when it first publishes or receives, at the latest: what it serves can be called then.
        Called again, this changes nothing.
        """

    @abstractmethod
    def has_reader(self, key: str) -> bool:
        """Return whether somebody subscribes to the key now: for who opens a session, publishes once and leaves."""

    @abstractmethod
    def wake(self) -> None:
        """Make a waiting (or a later) `receive` return None, in its turn.

        May be called from signal handlers and other threads.
        """

    @abstractmethod
    def post(self, event: object) -> None:
        """Put an event of this process's own (a camera's frame, a line from a serial port) in line with those of the bus.

        May be called from other threads. Who posts faster than the service reads keeps the newest to itself.
        """

    @abstractmethod
    def close(self) -> None:
        """Leave the bus. Never hangs; the second time does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _topic_to_publish(self, key: str) -> Topic:
        topic = self._declared(key)
        if self.name not in topic.publishers:
            raise NotPublisher(
                f"{self.name!r} may not publish `{key}`: its publishers are {', '.join(topic.publishers)} (schemas/topics.py)"
            )
        return topic

    def _declared(self, key: str) -> Topic:
        topic = self._topics.get(key)
        if topic is None:
            raise UndeclaredKey(f"`{key}` is not in the table of topics: declare it in schemas/topics.py")
        return topic

    def _topics_to_subscribe(self, expression: str, raw: bool) -> list[Topic]:
        named = [self._topics[key] for key in named_keys(expression, self._topics)]
        if not named and not raw:
            raise UndeclaredKey(f"`{expression}` names no topic: the table is schemas/topics.py")
        return named

    def _call_to_make(self, key: str, request: Message) -> Call:
        call = self._calls.get(key)
        if call is None:
            raise UndeclaredKey(f"`{key}` is not in the table of calls: declare it in schemas/topics.py")
        if type(request) is not call.request:
            raise WrongType(f"`{key}` is asked with {call.request.__name__}, not {type(request).__name__}")
        return call

    def _call_to_serve(self, key: str) -> Call:
        call = self._calls.get(key)
        if call is None:
            raise UndeclaredKey(f"`{key}` is not in the table of calls: declare it in schemas/topics.py")
        if self.name != call.server:
            raise NotPublisher(f"{self.name!r} may not serve `{key}`: its server is {call.server} (schemas/topics.py)")
        return call


def wrong_type(topic: Topic, message: object) -> WrongType:
    """Return the error for a message that is not of its topic's type."""
    return WrongType(f"`{topic.key}` carries {topic.type.__name__}, not {type(message).__name__}")
