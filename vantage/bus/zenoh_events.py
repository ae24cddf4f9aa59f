"""What Zenoh's threads put on a session's queue, and how the service's thread makes events of it.

The methods named `arrived`, `missed`, `replied` and `finished` run on Zenoh's threads and do nothing but queue.
"""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable, Mapping
from typing import Protocol

import zenoh
from zenoh import ext

from schemas import Call, Message, Topic
from vantage.bus.interface import NAME_LIMIT, Alive, Event, Lost, Reply, Request, Sample

QUEUE_LIMIT = 128 * 2**20
"""Bytes of one topic that may wait unread in a session; what comes beyond is lost, and reported as such."""

_STAMP = struct.Struct("<QQ")  # sequence, time of publishing; the publisher's name follows
_REFUSAL = zenoh.Encoding("text/plain").with_schema("vantage.Refusal")


def stamp(sequence: int, published: int, name: bytes) -> bytes:
    """Return what travels beside a message: number, time of publishing (ns), publisher."""
    return _STAMP.pack(sequence, published) + name


def unpack(attachment: zenoh.ZBytes | None) -> tuple[str, int, int]:
    """Return publisher, sequence and time of publishing; of a stranger's message nobody, 0 and now."""
    data = attachment.to_bytes() if attachment is not None else b""
    if _STAMP.size < len(data) <= _STAMP.size + NAME_LIMIT:
        sequence, published = _STAMP.unpack_from(data)
        name = data[_STAMP.size :]
        if name.isascii() and sequence < 2**63 and published < 2**63:
            return name.decode(), sequence, published
    return "", 0, time.time_ns()


def encoding_of(kind: type[Message]) -> zenoh.Encoding:
    """Return how a message type is marked on the wire."""
    return zenoh.Encoding("application/msgpack").with_schema(f"vantage.{kind.__name__}")


class Item(Protocol):
    """What Zenoh's threads put on the queue: made into an event (or nothing) on the service's thread."""

    def event(self) -> Event | None: ...


Put = Callable[[Item | None], None]


class Arrival:
    __slots__ = ("reader", "sample")

    def __init__(self, reader: Reader, sample: zenoh.Sample) -> None:
        self.reader = reader
        self.sample = sample

    def event(self) -> Event | None:
        sample = self.reader.read(self.sample)
        return sample if sample.published >= self.reader.since else None


class Reader:
    """One subscription: all messages, in order, as far as the queue's limit allows."""

    def __init__(self, put: Put, topic: Topic | None, prefix: str = "") -> None:
        self.put = put
        self.prefix = prefix
        self.topic = topic
        self.publisher = ""
        self.since = 0
        self._arrived = 0
        self._read = 0
        self._overflow: Overflow | None = None
        self._overflow_lock = threading.Lock()

    def arrived(self, sample: zenoh.Sample) -> None:
        size = len(sample.payload)
        if self._arrived - self._read + size > QUEUE_LIMIT:
            self._overflown()
            return
        self._arrived += size
        self.put(Arrival(self, sample))

    def missed(self, miss: ext.Miss) -> None:
        self.put(Missed(self, miss.nb))

    def read(self, sample: zenoh.Sample) -> Sample:
        payload = sample.payload.to_bytes()
        self._read += len(payload)
        return self.to_event(sample, payload)

    def to_event(self, sample: zenoh.Sample, payload: bytes) -> Sample:
        publisher, sequence, published = unpack(sample.attachment)
        if publisher:
            self.publisher = publisher
        return Sample(self.key_of(sample), payload, publisher, sequence, published, self.topic.type if self.topic else None)

    def key_of(self, sample: zenoh.Sample) -> str:
        return self.topic.key if self.topic else str(sample.key_expr).removeprefix(self.prefix)

    def lost(self, missed: int) -> Lost:
        return Lost(self.topic.key if self.topic else self.prefix, self.publisher, missed)

    def take_overflow(self) -> int:
        with self._overflow_lock:
            overflow, self._overflow = self._overflow, None
            return overflow.missed if overflow else 0

    def _overflown(self) -> None:
        with self._overflow_lock:
            if self._overflow is None:
                self._overflow = Overflow(self)
                self.put(self._overflow)
            self._overflow.missed += 1


class Missed:
    __slots__ = ("missed", "reader")

    def __init__(self, reader: Reader, missed: int) -> None:
        self.reader = reader
        self.missed = missed

    def event(self) -> Event | None:
        return self.reader.lost(self.missed)


class Overflow(Missed):
    """Stands on the queue where messages found no room, and counts them until it is read."""

    def __init__(self, reader: Reader) -> None:
        super().__init__(reader, 0)

    def event(self) -> Event | None:
        return self.reader.lost(self.reader.take_overflow())


class Newest(Reader):
    """A subscription that keeps the newest unread message only; it stands on the queue itself, once."""

    def __init__(self, put: Put, topic: Topic) -> None:
        super().__init__(put, topic)
        self._unread: zenoh.Sample | None = None
        self._lock = threading.Lock()

    def arrived(self, sample: zenoh.Sample) -> None:
        with self._lock:
            fresh = self._unread is None
            self._unread = sample
        if fresh:
            self.put(self)

    def event(self) -> Event | None:
        with self._lock:
            sample, self._unread = self._unread, None
        return self.to_event(sample, sample.payload.to_bytes()) if sample is not None else None


class Stranger(Reader):
    """The recorder's subscription to what no table declares."""

    def __init__(self, put: Put, prefix: str, declared: Mapping[str, Topic]) -> None:
        super().__init__(put, None, prefix)
        self._declared = {prefix + key for key in declared}

    def arrived(self, sample: zenoh.Sample) -> None:
        if str(sample.key_expr) not in self._declared:
            super().arrived(sample)


class Asked:
    """A question on the queue."""

    __slots__ = ("call", "next_token", "query")

    def __init__(self, call: Call, query: zenoh.Query, next_token: Callable[[], int]) -> None:
        self.call = call
        self.query = query
        self.next_token = next_token

    def event(self) -> Event | None:
        return ZenohRequest(self.call, self.query, self.next_token())


class ZenohRequest(Request):
    __slots__ = ("_query",)

    def __init__(self, call: Call, query: zenoh.Query, token: int) -> None:
        self._query = query
        payload = query.payload.to_bytes() if query.payload is not None else b""
        super().__init__(call, payload, unpack(query.attachment)[0], token)

    def _send(self, payload: bytes | None, error: str) -> None:
        try:
            if payload is not None:
                self._query.reply(self._query.key_expr, payload, encoding=encoding_of(self.call.reply), express=True)
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

    def event(self) -> Event | None:
        return self.reply(None, f"no answer to `{self.call.key}`: {self.call.server} is not running, or died before it answered")

    def reply(self, payload: bytes | None, error: str) -> Reply | None:
        if self.answered:
            return None
        self.answered = True
        return Reply(self.token, self.call.key, payload, error, self.call.reply)


class Replied:
    __slots__ = ("pending", "reply")

    def __init__(self, pending: Pending, reply: zenoh.Reply) -> None:
        self.pending = pending
        self.reply = reply

    def event(self) -> Event | None:
        answer, error = self.reply.ok, self.reply.err
        if answer is not None:
            return self.pending.reply(answer.payload.to_bytes(), "")
        if error is not None and error.encoding == _REFUSAL:
            return self.pending.reply(None, error.payload.to_bytes().decode(errors="replace"))
        call = self.pending.call
        return self.pending.reply(None, f"{call.server} did not answer `{call.key}` within {self.pending.timeout:g} s")


class LivelinessChange:
    __slots__ = ("sample",)

    def __init__(self, sample: zenoh.Sample) -> None:
        self.sample = sample

    def event(self) -> Event | None:
        name = str(self.sample.key_expr).rpartition("/")[2]
        return Alive(name, self.sample.kind == zenoh.SampleKind.PUT)
