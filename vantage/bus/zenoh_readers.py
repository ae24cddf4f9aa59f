"""Subscriptions over Zenoh: of a lossless topic, of a `latest` topic, and of what no table declares."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

import zenoh
from zenoh import ext
from zenoh.handlers import Callback

from schemas import Topic
from vantage.bus.clock import SteadyClock
from vantage.bus.interface import Event, Lost, Sample
from vantage.bus.stream import Missing, Stream
from vantage.bus.zenoh_events import NUMBERS, ORIGIN, Item, Put, Stamp, unpack

QUEUE_LIMIT = 128 * 2**20
"""Bytes of one topic that may wait unread in a raw session; more is dropped (and of a lossless topic fetched later)."""

ANSWER_TIME = 2.0
"""Seconds that a publisher's cache has to answer."""

PATIENCE = 10.0
"""Seconds for which a publisher that is out of reach, and still owes something, is waited for."""

HELD_LIMIT = 1024
"""Messages of a lossless topic that wait for missing ones (or as many as the topic's cache holds)."""


_unpack_numbers = NUMBERS.unpack_from


class Reader:
    """A subscription that passes on everything as it comes."""

    def __init__(self, put: Put, prefix: str, topic: Topic | None, clock: SteadyClock) -> None:
        self.put = put
        self.prefix = prefix
        self.topic = topic
        self.clock = clock
        self._arrived = 0
        self._read = 0

    def declare(self, session: zenoh.Session) -> list[Any]:
        """Subscribe. Returns what must be kept for the subscription to last."""
        assert self.topic is not None
        history = ext.HistoryConfig(detect_late_publishers=True, max_samples=self.topic.history) if self.topic.history else None
        key = self.prefix + self.topic.key
        return [ext.declare_advanced_subscriber(session, key, Callback(self.arrived, indirect=False), history=history)]

    def arrived(self, sample: zenoh.Sample) -> None:
        size = len(sample.payload)
        if self._arrived - self._read + size <= QUEUE_LIMIT:
            self._arrived += size
            self.put(Arrival(self, sample, size))

    def taken(self, size: int) -> None:
        """Take note that so many bytes wait no more."""
        self._read += size

    def read(self, sample: zenoh.Sample, ready: deque[Event]) -> None:
        ready.append(self.event(sample, unpack(sample.attachment)))

    def event(self, sample: zenoh.Sample, stamp: Stamp | None) -> Sample:
        payload = sample.payload.to_bytes()
        key = self.topic.key if self.topic else str(sample.key_expr).removeprefix(self.prefix)
        kind = self.topic.type if self.topic else None
        if stamp is None:
            return Sample(key, payload, "", 0, self.clock.wall(), kind)
        shift = stamp.shift(self.clock)
        # One wall clock for all publishers of this machine, whenever they started.
        published = stamp.published + (0 if shift is None else shift + self.clock.wall_minus_steady)
        return Sample(key, payload, stamp.publisher, stamp.sequence, published, kind, None, stamp.published)


class Arrival:
    __slots__ = ("reader", "sample", "size")

    def __init__(self, reader: Reader, sample: zenoh.Sample, size: int) -> None:
        self.reader = reader
        self.sample = sample
        self.size = size

    def handle(self, ready: deque[Event]) -> None:
        self.reader.taken(self.size)
        self.reader.read(self.sample, ready)


class Strangers(Reader):
    """The recorder's subscription to what no table declares."""

    def __init__(self, put: Put, prefix: str, expression: str, declared: Mapping[str, Topic], clock: SteadyClock) -> None:
        super().__init__(put, prefix, None, clock)
        self._expression = expression
        self._declared = {prefix + key for key in declared}

    def declare(self, session: zenoh.Session) -> list[Any]:
        return [session.declare_subscriber(self.prefix + self._expression, Callback(self.arrived, indirect=False))]

    def arrived(self, sample: zenoh.Sample) -> None:
        if str(sample.key_expr) not in self._declared:
            super().arrived(sample)


class Newest(Reader):
    """A subscription that keeps the newest unread message only; it stands on the queue itself, once."""

    def __init__(self, put: Put, prefix: str, topic: Topic, clock: SteadyClock) -> None:
        super().__init__(put, prefix, topic, clock)
        self._unread: zenoh.Sample | None = None
        self._lock = threading.Lock()

    def arrived(self, sample: zenoh.Sample) -> None:
        with self._lock:
            fresh = self._unread is None
            self._unread = sample
        if fresh:
            self.put(self)

    def handle(self, ready: deque[Event]) -> None:
        with self._lock:
            sample, self._unread = self._unread, None
        if sample is not None:
            self.read(sample, ready)


Later = Callable[[float, Item], None]
"""Have an item handled after so many seconds."""


class _Source:
    """One publisher, from its start to its end, as a lossless subscription knows it."""

    __slots__ = ("identity", "publisher", "stream", "to_wall")

    def __init__(self, identity: str, stream: Stream[Sample]) -> None:
        self.identity = identity  # zid/eid, as in the keys of its cache, its token and its heartbeat
        self.publisher = ""
        self.stream = stream
        self.to_wall = 0  # ns to add to its times of publishing


class Lossless(Reader):
    """A subscription that gets every message, in order, or says how many could not be had.

    The publisher is a zenoh-ext AdvancedPublisher. Below `<key>/@adv/pub/<zid>/<eid>/` it has a liveliness token, a heartbeat
    with its last sequence number, and a cache that answers `_max=<count>` and `_sn=<first>..`.
    """

    def __init__(self, put: Put, later: Later, prefix: str, topic: Topic, raw: bool, clock: SteadyClock) -> None:
        super().__init__(put, prefix, topic, clock)
        self._later = later
        self._key = prefix + topic.key
        self._short_key = topic.key
        self._kind = topic.type
        self._topic = topic
        self._history = max(topic.cache, topic.history) if raw else topic.history
        # Zenoh's thread queues the bare sample, if it need not look at it: not a line of Python runs there.
        self._callback = self.arrived if raw else put
        self._since = clock.now()
        self._by_identity: dict[str, _Source] = {}
        self._by_origin: dict[bytes, _Source] = {}
        self._session: zenoh.Session | None = None

    def declare(self, session: zenoh.Session) -> list[Any]:
        self._session = session
        about = f"{self._key}/@adv/pub/**"
        return [
            session.declare_subscriber(self._key, Callback(self._callback, indirect=False)),
            session.declare_subscriber(about, Callback(self.heard, indirect=False)),
            session.liveliness().declare_subscriber(about, Callback(self.noticed, indirect=False), history=True),
        ]

    def heard(self, heartbeat: zenoh.Sample) -> None:
        self.put(_Heartbeat(self, heartbeat))

    def noticed(self, token: zenoh.Sample) -> None:
        self.put(_Token(self, token))

    def next_event(self, sample: zenoh.Sample) -> Sample | None:
        """Return the event of a message that comes as expected; else None, and `read` must have it. The short way of `read`."""
        attachment = sample.attachment
        if attachment is not None:
            data = attachment.to_bytes()
            source = self._by_origin.get(data[ORIGIN:])
            if source is not None:
                sequence, sent = NUMBERS.unpack_from(data)
                if source.stream.follows(sequence):
                    payload, published = sample.payload.to_bytes(), sent + source.to_wall
                    return Sample(self._topic.key, payload, source.publisher, sequence, published, self._topic.type, None, sent)
        return None

    def read(self, sample: zenoh.Sample, ready: deque[Event]) -> None:
        stamp = unpack(sample.attachment)
        event = self.event(sample, stamp)
        source = (self._by_origin.get(stamp.origin) or self._meet(stamp, sample.source_info, ready)) if stamp else None
        if source is None or stamp is None or source.stream.follows(stamp.sequence):
            ready.append(event)
        else:
            owes_all = bool(self._is_since(stamp, stamp.started))
            self.deliver(source, source.stream.arrived(stamp.sequence, event, owes_all=owes_all), ready)

    def _is_since(self, stamp: Stamp, time: int) -> bool | None:
        """Return whether a time of a publisher is after this subscription; None where no common clock tells."""
        shift = stamp.shift(self.clock)
        return None if shift is None else time + shift >= self._since

    def _meet(self, stamp: Stamp, info: zenoh.SourceInfo | None, ready: deque[Event]) -> _Source | None:
        if info is None:
            return None
        source = self.source(f"{info.source_id.zid}/{info.source_id.eid}")
        source.publisher = stamp.publisher
        if (shift := stamp.shift(self.clock)) is not None:
            source.to_wall = shift + self.clock.wall_minus_steady
        for other in self._by_identity.values():
            # A name is on the bus once: what it published before its restart ends here.
            if other is not source and other.publisher == source.publisher:
                self.abandon(other, ready)
        self._by_origin[stamp.origin] = source
        return source

    def source(self, identity: str) -> _Source:
        """Return what is known of a publisher, from now on at the latest."""
        source = self._by_identity.get(identity)
        if source is None:
            stream: Stream[Sample] = Stream(self._history, max(HELD_LIMIT, self._topic.cache))
            source = self._by_identity[identity] = _Source(identity, stream)
        return source

    def left(self, source: _Source) -> None:
        if source.stream.left():
            self._later(PATIENCE, _Abandoned(self, source))

    def answered(self, source: _Source, stamp: Stamp, event: Sample, ready: deque[Event]) -> None:
        """Take a message out of a publisher's cache."""
        since = self._is_since(stamp, stamp.published)
        old = None if since is None else not since
        owes_all = bool(self._is_since(stamp, stamp.started))
        self.deliver(source, source.stream.answered(stamp.sequence, event, old=old, owes_all=owes_all), ready)

    def abandon(self, source: _Source, ready: deque[Event]) -> None:
        self.deliver(source, source.stream.abandon(), ready)

    def deliver(self, source: _Source, items: list[Sample | Missing], ready: deque[Event]) -> None:
        """Make events of what a stream delivers, then ask what it wants to know."""
        for item in items:
            ready.append(Lost(self._topic.key, source.publisher, item.count) if isinstance(item, Missing) else item)
        question = source.stream.question()
        if question is not None and self._session is not None:
            asked = _Question(self, source)
            self._session.get(
                f"{self._key}/@adv/pub/{source.identity}/**?{question}",
                Callback(asked.replied, asked.finished, indirect=False),
                consolidation=zenoh.ConsolidationMode.NONE,
                accept_replies=zenoh.ReplyKeyExpr.ANY,
                # The answers are sent as the question is: BLOCK would hold up the publisher's receiving thread.
                congestion_control=zenoh.CongestionControl.DROP,
                timeout=ANSWER_TIME,
            )


def _identity(key: zenoh.KeyExpr) -> str:
    """Return the publisher's zid/eid, from the key of its token or heartbeat; empty when the key has none."""
    chunks = str(key).partition("/@adv/pub/")[2].split("/")
    return "/".join(chunks[:2]) if len(chunks) >= 2 and chunks[1].isdecimal() else ""


class _Heartbeat:
    __slots__ = ("reader", "sample")

    def __init__(self, reader: Lossless, sample: zenoh.Sample) -> None:
        self.reader = reader
        self.sample = sample

    def handle(self, ready: deque[Event]) -> None:
        identity, payload = _identity(self.sample.key_expr), self.sample.payload.to_bytes()
        if identity and len(payload) == 4:
            source = self.reader.source(identity)
            source.stream.announced(int.from_bytes(payload, "little"))
            self.reader.deliver(source, [], ready)


class _Token:
    __slots__ = ("reader", "sample")

    def __init__(self, reader: Lossless, sample: zenoh.Sample) -> None:
        self.reader = reader
        self.sample = sample

    def handle(self, ready: deque[Event]) -> None:
        identity = _identity(self.sample.key_expr)
        if identity:
            source = self.reader.source(identity)
            if self.sample.kind == zenoh.SampleKind.PUT:
                source.stream.announced(-1)
                self.reader.deliver(source, [], ready)
            else:
                self.reader.left(source)


class _Abandoned:
    __slots__ = ("reader", "source")

    def __init__(self, reader: Lossless, source: _Source) -> None:
        self.reader = reader
        self.source = source

    def handle(self, ready: deque[Event]) -> None:
        self.reader.abandon(self.source, ready)


class _Question:
    """A question to a publisher's cache; on the queue, it is the news that all answers are there."""

    __slots__ = ("reader", "source")

    def __init__(self, reader: Lossless, source: _Source) -> None:
        self.reader = reader
        self.source = source

    def replied(self, reply: zenoh.Reply) -> None:
        self.reader.put(_Answer(self, reply))

    def finished(self) -> None:
        self.reader.put(self)

    def handle(self, ready: deque[Event]) -> None:
        self.reader.deliver(self.source, self.source.stream.ended(), ready)


class _Answer:
    __slots__ = ("question", "reply")

    def __init__(self, question: _Question, reply: zenoh.Reply) -> None:
        self.question = question
        self.reply = reply

    def handle(self, ready: deque[Event]) -> None:
        sample, reader, source = self.reply.ok, self.question.reader, self.question.source
        stamp = unpack(sample.attachment) if sample is not None else None
        if sample is None or stamp is None:
            return
        source.publisher = stamp.publisher
        reader.answered(source, stamp, reader.event(sample, stamp), ready)
