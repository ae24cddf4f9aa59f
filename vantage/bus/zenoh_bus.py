"""The bus between processes, over Zenoh.

Zenoh's threads only push what they get onto one queue; everything else happens on the service's thread, in `receive`.
"""

from __future__ import annotations

import atexit
import os
import queue
import struct
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import zenoh
from zenoh import ext
from zenoh.handlers import Callback

from schemas import CALLS, TOPICS, Call, Message, Topic, encode
from vantage.bus.interface import Alive, Bus, CannotOpen, Event, Lost, Reply, Request, Sample, wrong_type
from vantage.bus.zenoh_session import open_session

HEARTBEAT = 0.2
"""Seconds between a publisher's notes of its last sequence number, by which readers notice that the last message is missing."""

QUEUE_LIMIT = 128 * 2**20
"""Bytes of one topic that may wait unread in a session; what comes beyond is lost, and reported as such."""

_STAMP = struct.Struct("<QQ")  # sequence, time of publishing; the publisher's name follows
_REFUSAL = zenoh.Encoding("text/plain").with_schema("vantage.Refusal")


class _Item(Protocol):
    """What Zenoh's threads put on the queue: made into an event (or nothing) on the service's thread."""

    def event(self) -> Event | None: ...


class _Arrival:
    __slots__ = ("reader", "sample")

    def __init__(self, reader: _Reader, sample: zenoh.Sample) -> None:
        self.reader = reader
        self.sample = sample

    def event(self) -> Event | None:
        sample = self.reader.read(self.sample)
        return sample if sample.published >= self.reader.since else None


class _Reader:
    """One subscription: all messages, in order, as far as the queue's limit allows."""

    def __init__(self, bus: ZenohBus, topic: Topic | None) -> None:
        self.put = bus.put
        self.prefix = bus.prefix
        self.topic = topic
        self.publisher = ""
        self.since = 0
        self._arrived = 0
        self._read = 0
        self._overflow: _Overflow | None = None
        self._overflow_lock = threading.Lock()

    def arrived(self, sample: zenoh.Sample) -> None:
        size = len(sample.payload)
        if self._arrived - self._read + size > QUEUE_LIMIT:
            self._overflown()
            return
        self._arrived += size
        self.put(_Arrival(self, sample))

    def missed(self, miss: ext.Miss) -> None:
        self.put(_Missed(self, miss.nb))

    def read(self, sample: zenoh.Sample) -> Sample:
        payload = sample.payload.to_bytes()
        self._read += len(payload)
        return self.to_event(sample, payload)

    def to_event(self, sample: zenoh.Sample, payload: bytes) -> Sample:
        publisher, sequence, published = _unpack(sample.attachment)
        if self.topic is None:
            return Sample(str(sample.key_expr).removeprefix(self.prefix), payload, publisher, sequence, published)
        if publisher:
            self.publisher = publisher
        return Sample(self.topic.key, payload, publisher, sequence, published, self.topic.type)

    def lost(self, missed: int) -> Lost:
        return Lost(self.topic.key if self.topic else "", self.publisher, missed)

    def take_overflow(self) -> int:
        with self._overflow_lock:
            overflow, self._overflow = self._overflow, None
            return overflow.missed if overflow else 0

    def _overflown(self) -> None:
        with self._overflow_lock:
            if self._overflow is None:
                self._overflow = _Overflow(self)
                self.put(self._overflow)
            self._overflow.missed += 1


class _Missed:
    __slots__ = ("missed", "reader")

    def __init__(self, reader: _Reader, missed: int) -> None:
        self.reader = reader
        self.missed = missed

    def event(self) -> Event | None:
        return self.reader.lost(self.missed)


class _Overflow(_Missed):
    """Stands on the queue where messages found no room, and counts them until it is read."""

    def __init__(self, reader: _Reader) -> None:
        super().__init__(reader, 0)

    def event(self) -> Event | None:
        return self.reader.lost(self.reader.take_overflow())


class _Newest(_Reader):
    """A subscription that keeps the newest unread message only; it stands on the queue itself, once."""

    def __init__(self, bus: ZenohBus, topic: Topic) -> None:
        super().__init__(bus, topic)
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


class _Stranger(_Reader):
    """The recorder's subscription to what no table declares."""

    def __init__(self, bus: ZenohBus, declared: Mapping[str, Topic]) -> None:
        super().__init__(bus, None)
        self._declared = {bus.prefix + key for key in declared}

    def arrived(self, sample: zenoh.Sample) -> None:
        if str(sample.key_expr) not in self._declared:
            super().arrived(sample)


class _Asked:
    """A question on the queue."""

    __slots__ = ("bus", "call", "query")

    def __init__(self, bus: ZenohBus, call: Call, query: zenoh.Query) -> None:
        self.bus = bus
        self.call = call
        self.query = query

    def event(self) -> Event | None:
        return _ZenohRequest(self.call, self.query, self.bus.next_request())


class _ZenohRequest(Request):
    __slots__ = ("_query",)

    def __init__(self, call: Call, query: zenoh.Query, token: int) -> None:
        self._query = query
        payload = query.payload.to_bytes() if query.payload is not None else b""
        super().__init__(call, payload, _unpack(query.attachment)[0], token)

    def _send(self, payload: bytes | None, error: str) -> None:
        try:
            if payload is not None:
                self._query.reply(self._query.key_expr, payload, encoding=_encoding(self.call.reply), express=True)
            else:
                self._query.reply_err(error.encode(), encoding=_REFUSAL)
            self._query.drop()
        except zenoh.ZError:
            # The caller or this session is gone; the caller's own time-out speaks for us.
            pass

    def __del__(self) -> None:
        self.fail(f"the server dropped the request for `{self.key}` without an answer")


class _Pending:
    """A call under way; on the queue, it is the news that Zenoh has finished it."""

    __slots__ = ("answered", "bus", "call", "timeout", "token")

    def __init__(self, bus: ZenohBus, call: Call, token: int, timeout: float) -> None:
        self.bus = bus
        self.call = call
        self.token = token
        self.timeout = timeout
        self.answered = False

    def replied(self, reply: zenoh.Reply) -> None:
        self.bus.put(_Replied(self, reply))

    def finished(self) -> None:
        self.bus.put(self)

    def event(self) -> Event | None:
        return self.reply(None, f"no answer to `{self.call.key}`: {self.call.server} is not running, or died before it answered")

    def reply(self, payload: bytes | None, error: str) -> Reply | None:
        if self.answered:
            return None
        self.answered = True
        return Reply(self.token, self.call.key, payload, error, self.call.reply)


class _Replied:
    __slots__ = ("pending", "reply")

    def __init__(self, pending: _Pending, reply: zenoh.Reply) -> None:
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


class _LivelinessChange:
    __slots__ = ("sample",)

    def __init__(self, sample: zenoh.Sample) -> None:
        self.sample = sample

    def event(self) -> Event | None:
        name = str(self.sample.key_expr).rpartition("/")[2]
        return Alive(name, self.sample.kind == zenoh.SampleKind.PUT)


class _Writer:
    """One key this session publishes."""

    def __init__(self, session: zenoh.Session, prefix: str, topic: Topic) -> None:
        self.topic = topic
        self.kind = topic.type
        self.sequence = 0
        self.put = _declare_publisher(session, prefix, topic).put


class ZenohBus(Bus):
    """One participant's session over Zenoh, closed to everybody who cannot enter `folder`.

    Args:
        name: this participant; its socket is `<folder>/<name>.sock`.
        folder: where the deployment's sockets are; made with mode 0700.
        arena: the deployment's arena: keys stand under `vantage/<arena>/`.

    Raises:
        NameInUse, CannotOpen: see `open_session`.
    """

    def __init__(
        self,
        name: str,
        folder: Path,
        arena: str = "table",
        *,
        topics: Mapping[str, Topic] = TOPICS,
        calls: Mapping[str, Call] = CALLS,
    ) -> None:
        super().__init__(name, arena, topics, calls)
        self.prefix = f"vantage/{arena}/"
        self._inbox: queue.SimpleQueue[_Item | None] = queue.SimpleQueue()
        self.put = self._inbox.put
        self._writers: dict[str, _Writer] = {}
        self._reading: set[str] = set()
        self._kept: list[Any] = []  # Zenoh undeclares what nobody holds
        self._encoded_name = name.encode()
        self._last_published = 0
        self._calls_made = 0
        self._requests_made = 0
        self._watching = False
        self._process = os.getpid()
        self._session: zenoh.Session | None = open_session(name, folder)
        _open_buses.add(self)
        self._kept.append(self._session.liveliness().declare_token(f"{self._alive_prefix}{name}"))

    @property
    def _alive_prefix(self) -> str:
        return f"vantage-alive/{self.arena}/"

    def publish(self, key: str, message: Message) -> None:
        writer = self._writers.get(key) or self._writer(key)
        if type(message) is not writer.kind:
            raise wrong_type(writer.topic, message)
        writer.put(encode(message), attachment=_STAMP.pack(writer.sequence, self._now()) + self._encoded_name)
        writer.sequence += 1

    def _writer(self, key: str) -> _Writer:
        topic = self._topic_to_publish(key)
        writer = self._writers[key] = _Writer(self._opened(), self.prefix, topic)
        return writer

    def _now(self) -> int:
        self._last_published = max(time.time_ns(), self._last_published + 1)
        return self._last_published

    def subscribe(self, *expressions: str, raw: bool = False) -> None:
        session = self._opened()
        for expression in expressions:
            for topic in self._topics_to_subscribe(expression, raw):
                if topic.key not in self._reading:
                    self._reading.add(topic.key)
                    self._subscribe(session, topic, raw)
            if raw and "*" in expression:
                strangers = Callback(_Stranger(self, self._topics).arrived, indirect=False)
                self._kept.append(session.declare_subscriber(self.prefix + expression, strangers))

    def _subscribe(self, session: zenoh.Session, topic: Topic, raw: bool) -> None:
        reader = _Newest(self, topic) if topic.delivery == "latest" and not raw else _Reader(self, topic)
        past = max(topic.cache, topic.history) if raw and topic.delivery == "lossless" else topic.history
        if not past:
            # Zenoh, asked for no history, would fetch everything at the first heartbeat: ask for one, and set it aside.
            past, reader.since = 1, time.time_ns()
        subscriber = ext.declare_advanced_subscriber(
            session,
            self.prefix + topic.key,
            Callback(reader.arrived, indirect=False),
            history=ext.HistoryConfig(detect_late_publishers=True, max_samples=past),
            recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True) if topic.delivery == "lossless" else None,
        )
        self._kept.append(subscriber)
        if topic.delivery == "lossless":
            self._kept.append(subscriber.sample_miss_listener(Callback(reader.missed, indirect=False)))

    def receive(self, timeout: float) -> Event | None:
        end = time.monotonic() + timeout
        while True:
            try:
                item = self._inbox.get(timeout=max(0.0, end - time.monotonic())) if timeout > 0 else self._inbox.get_nowait()
            except queue.Empty:
                return None
            if item is None:
                return None
            event = item.event()
            if event is not None:
                return event

    def call(self, key: str, request: Message, timeout: float) -> int:
        call = self._call_to_make(key, request)
        self._calls_made += 1
        pending = _Pending(self, call, self._calls_made, timeout)
        self._opened().get(
            self.prefix + key,
            Callback(pending.replied, pending.finished, indirect=False),
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout,
            congestion_control=zenoh.CongestionControl.BLOCK,
            express=True,
            payload=encode(request),
            encoding=_encoding(call.request),
            attachment=_STAMP.pack(pending.token, self._now()) + self._encoded_name,
        )
        return pending.token

    def serve(self, key: str) -> None:
        call = self._call_to_serve(key)

        def asked(query: zenoh.Query) -> None:
            self.put(_Asked(self, call, query))

        self._kept.append(self._opened().declare_queryable(self.prefix + key, Callback(asked, indirect=False), complete=True))

    def watch(self) -> None:
        if self._watching:
            return
        self._watching = True

        def changed(sample: zenoh.Sample) -> None:
            self.put(_LivelinessChange(sample))

        liveliness = self._opened().liveliness()
        self._kept.append(
            liveliness.declare_subscriber(self._alive_prefix + "*", Callback(changed, indirect=False), history=True)
        )

    def has_reader(self, key: str) -> bool:
        self._declared(key)
        with self._opened().declare_publisher(self.prefix + key) as publisher:
            return publisher.matching_status.matching

    def wake(self) -> None:
        self.put(None)

    def close(self) -> None:
        session, self._session = self._session, None
        _open_buses.discard(self)
        # A forked child holds a copy of the session without its threads: closing that would wait for ever.
        if session is None or os.getpid() != self._process:
            return
        session.close()
        self._kept.clear()
        self._writers.clear()

    def next_request(self) -> int:
        """Return the token of the next question to this session."""
        self._requests_made += 1
        return self._requests_made

    def _opened(self) -> zenoh.Session:
        if self._session is None:
            raise CannotOpen(f"the session of {self.name!r} is closed")
        return self._session


def _declare_publisher(session: zenoh.Session, prefix: str, topic: Topic) -> ext.AdvancedPublisher:
    lossless = topic.delivery == "lossless"
    kept = max(topic.cache, topic.history) if lossless else topic.history
    return ext.declare_advanced_publisher(
        session,
        prefix + topic.key,
        encoding=_encoding(topic.type),
        # Never BLOCK: it waits for seconds and then closes the transport. What is dropped is fetched from the cache.
        congestion_control=zenoh.CongestionControl.DROP,
        express=True,
        cache=ext.CacheConfig(kept) if kept else None,
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=HEARTBEAT, sporadic_heartbeat=None) if lossless else None,
        publisher_detection=True,
    )


def _encoding(kind: type[Message]) -> zenoh.Encoding:
    return zenoh.Encoding("application/msgpack").with_schema(f"vantage.{kind.__name__}")


def _unpack(attachment: zenoh.ZBytes | None) -> tuple[str, int, int]:
    """Return publisher, sequence and time of publishing; of a stranger's message nobody, 0 and now."""
    data = attachment.to_bytes() if attachment is not None else b""
    if len(data) <= _STAMP.size:
        return "", 0, time.time_ns()
    try:
        name = data[_STAMP.size :].decode()
    except UnicodeDecodeError:
        return "", 0, time.time_ns()
    sequence, published = _STAMP.unpack_from(data)
    return name, sequence, published


_open_buses: set[ZenohBus] = set()


@atexit.register
def _close_all() -> None:
    for bus in list(_open_buses):
        bus.close()
