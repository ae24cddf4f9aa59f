"""What Zenoh's threads put on a session's queue, and how the service's thread makes events of it.

The methods named `arrived`, `noticed`, `replied` and `finished` run on Zenoh's threads and do nothing but queue.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import zenoh

from schemas import Call, Message
from vantage.bus.clock import IDENTITY_SIZE, SteadyClock
from vantage.bus.interface import NAME_LIMIT, Alive, Event, Reply, Request

NUMBERS = struct.Struct("<QQ")
"""Sequence and time of publishing, at the head of an attachment; the origin follows."""

ORIGIN = NUMBERS.size

_STARTED = struct.Struct("<Q")
_CLOCK = struct.Struct(f"<{IDENTITY_SIZE}sq")
_END_OF_NAME = b"\0"

_REFUSAL = zenoh.Encoding("text/plain").with_schema("vantage.Refusal")


@dataclass(slots=True)
class Stamp:
    """What travels beside a message.

    Attributes:
        sequence: number of the message on its key, from 0 at each start of the publisher.
        published: ns, by the publisher's wall clock as it was when it started.
        origin: start time (8 bytes) and name of the publisher: the same for all it publishes, another after a restart. Our own
            publishers add a zero byte, the identity of their steady clock, and its reading at the start.
    """

    sequence: int
    published: int
    origin: bytes

    @property
    def publisher(self) -> str:
        return self.origin[_STARTED.size :].partition(_END_OF_NAME)[0].decode()

    @property
    def started(self) -> int:
        return int(_STARTED.unpack_from(self.origin)[0])

    def shift(self, clock: SteadyClock) -> int | None:
        """Return what turns times of this publisher into times of `clock`, ns; None where no common clock tells."""
        _, separator, rest = self.origin[_STARTED.size :].partition(_END_OF_NAME)
        if not separator:
            return None
        identity, started = _CLOCK.unpack(rest)
        return int(started) - self.started if identity == clock.identity else None


def origin_of(name: str, clock: SteadyClock) -> bytes:
    """Return the origin of a publisher that starts now."""
    started = clock.now()
    return _STARTED.pack(started + clock.wall_minus_steady) + name.encode() + _END_OF_NAME + _CLOCK.pack(clock.identity, started)


def pack(sequence: int, published: int, origin: bytes) -> bytes:
    """Return the attachment of a message."""
    return NUMBERS.pack(sequence, published) + origin


def unpack(attachment: zenoh.ZBytes | None) -> Stamp | None:
    """Return the stamp of a message; None when it is a stranger's."""
    data = attachment.to_bytes() if attachment is not None else b""
    origin = data[ORIGIN:]
    name, separator, clock = origin[_STARTED.size :].partition(_END_OF_NAME)
    if not 0 < len(name) <= NAME_LIMIT or not name.isascii() or (separator and len(clock) != _CLOCK.size):
        return None
    sequence, published = NUMBERS.unpack_from(data)
    if sequence >= 2**63 or published >= 2**63:
        return None
    return Stamp(sequence, published, origin)


def encoding_of(kind: type[Message]) -> zenoh.Encoding:
    """Return how a message type is marked on the wire."""
    return zenoh.Encoding("application/msgpack").with_schema(f"vantage.{kind.__name__}")


class Item(Protocol):
    """What Zenoh's threads put on the queue; `handle` appends the events that follow from it, on the service's thread."""

    def handle(self, ready: deque[Event]) -> None: ...


Put = Callable[[Item | zenoh.Sample | None], None]


class Asked:
    """A question on the queue."""

    __slots__ = ("call", "next_token", "query")

    def __init__(self, call: Call, query: zenoh.Query, next_token: Callable[[], int]) -> None:
        self.call = call
        self.query = query
        self.next_token = next_token

    def handle(self, ready: deque[Event]) -> None:
        ready.append(ZenohRequest(self.call, self.query, self.next_token()))


class ZenohRequest(Request):
    __slots__ = ("_query",)

    def __init__(self, call: Call, query: zenoh.Query, token: int) -> None:
        self._query = query
        payload = query.payload.to_bytes() if query.payload is not None else b""
        stamp = unpack(query.attachment)
        super().__init__(call, payload, stamp.publisher if stamp else "", token)

    def _send(self, payload: bytes | None, error: str) -> None:
        try:
            if payload is not None:
                self._query.reply(self._query.key_expr, payload, encoding=encoding_of(self.call.reply))
            else:
                self._query.reply_err(error.encode(), encoding=_REFUSAL)
            self._query.drop()
        except zenoh.ZError:
            # The caller or this session is gone; the caller's own time-out speaks for us.
            pass

    def __del__(self) -> None:
        self.fail(f"the server dropped the request for `{self.key}` without an answer")


class Pending:
    """A call under way; on the queue, it is the news that Zenoh has finished it."""

    __slots__ = ("answered", "call", "put", "timeout", "token")

    def __init__(self, put: Put, call: Call, token: int, timeout: float) -> None:
        self.put = put
        self.call = call
        self.token = token
        self.timeout = timeout
        self.answered = False

    def replied(self, reply: zenoh.Reply) -> None:
        self.put(Replied(self, reply))

    def finished(self) -> None:
        self.put(self)

    def handle(self, ready: deque[Event]) -> None:
        self.end(ready, None, f"no answer to `{self.call.key}`: {self.call.server} is not running, or died before it answered")

    def end(self, ready: deque[Event], payload: bytes | None, error: str) -> None:
        """End the call, unless it has ended: the first answer counts."""
        if not self.answered:
            self.answered = True
            ready.append(Reply(self.token, self.call.key, payload, error, self.call.reply))


class Replied:
    __slots__ = ("pending", "reply")

    def __init__(self, pending: Pending, reply: zenoh.Reply) -> None:
        self.pending = pending
        self.reply = reply

    def handle(self, ready: deque[Event]) -> None:
        answer, error = self.reply.ok, self.reply.err
        if answer is not None:
            self.pending.end(ready, answer.payload.to_bytes(), "")
        elif error is not None and error.encoding == _REFUSAL:
            self.pending.end(ready, None, error.payload.to_bytes().decode(errors="replace"))
        else:
            call = self.pending.call
            self.pending.end(ready, None, f"{call.server} did not answer `{call.key}` within {self.pending.timeout:g} s")


class LivelinessChange:
    __slots__ = ("sample",)

    def __init__(self, sample: zenoh.Sample) -> None:
        self.sample = sample

    def handle(self, ready: deque[Event]) -> None:
        name = str(self.sample.key_expr).rpartition("/")[2]
        ready.append(Alive(name, self.sample.kind == zenoh.SampleKind.PUT))


class Posted:
    """An event of this process's own."""

    __slots__ = ("event",)

    def __init__(self, event: object) -> None:
        self.event = event

    def handle(self, ready: deque[Event]) -> None:
        ready.append(self.event)  # type: ignore[arg-type]
