"""The bus between processes, over Zenoh.

Zenoh's threads only push what they get onto one queue; everything else happens on the service's thread, in `receive`.
"""

from __future__ import annotations

import atexit
import contextlib
import heapq
import itertools
import os
import queue
import threading
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import zenoh
from zenoh import ext
from zenoh.handlers import Callback

from schemas import CALLS, TOPICS, Call, Message, Topic, encode
from vantage.bus.allocator import keep_freed_memory
from vantage.bus.clock import MACHINE, SteadyClock
from vantage.bus.interface import Bus, CannotOpen, Event, wrong_type
from vantage.bus.zenoh_events import NUMBERS, Asked, Item, LivelinessChange, Pending, Posted, encoding_of, origin_of, pack
from vantage.bus.zenoh_readers import Lossless, Newest, Reader, Strangers
from vantage.bus.zenoh_session import open_session

HEARTBEAT = 0.2
"""Seconds between a publisher's notes of its last sequence number, by which readers notice that the last message is missing."""


CLOSE_TIME = 1.0
"""Seconds that closing may take."""


_pack_numbers = NUMBERS.pack


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
        clock: the machine's, unless a test brings one.

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
        clock: SteadyClock = MACHINE,
    ) -> None:
        super().__init__(name, arena, topics, calls)
        self._clock = clock
        self.prefix = f"vantage/{arena}/"
        self._inbox: queue.SimpleQueue[Item | zenoh.Sample | None] = queue.SimpleQueue()
        self.put = self._inbox.put
        self._get = self._inbox.get
        self._writers: dict[str, _Writer] = {}
        self._reading: set[str] = set()
        self._direct: dict[str, Lossless] = {}  # who reads the bare samples on the queue, by their whole key
        self._kept: list[Any] = []  # Zenoh undeclares what nobody holds
        self._origin = origin_of(name, clock)
        self._ready: deque[Event] = deque()
        self._timers: list[tuple[float, int, Item]] = []
        self._timer_numbers = itertools.count()
        self._published = 0
        self._calls_made = 0
        self._requests_made = 0
        self._announced = False
        self._watching = False
        self._process = os.getpid()
        publishers = {publisher for topic in topics.values() for publisher in topic.publishers}
        known = publishers | {call.server for call in calls.values()}
        keep_freed_memory()
        self._session: zenoh.Session | None = open_session(name, folder, frozenset(known))
        _open_buses.add(self)

    @property
    def _alive_prefix(self) -> str:
        return f"vantage-alive/{self.arena}/"

    def publish(self, key: str, message: Message) -> None:
        writer = self._writers.get(key) or self._writer(key)
        if type(message) is not writer.kind:
            raise wrong_type(writer.topic, message)
        payload = encode(message)
        self._published = now = max(self._clock.wall(), self._published + 1)  # unique
        sequence = writer.sequence
        writer.sequence += 1
        writer.put(payload, attachment=_pack_numbers(sequence, now) + self._origin)

    def _writer(self, key: str) -> _Writer:
        topic = self._topic_to_publish(key)
        writer = self._writers[key] = _Writer(self._opened(), self.prefix, topic)
        self._announce()
        return writer

    def _announce(self) -> None:
        """Show that this participant is there, which only now, with its subscriptions and servers made, it really is."""
        if not self._announced:
            self._announced = True
            self._kept.append(self._opened().liveliness().declare_token(self._alive_prefix + self.name))

    def subscribe(self, *expressions: str, raw: bool = False) -> None:
        session = self._opened()
        for expression in expressions:
            for topic in self._topics_to_subscribe(expression, raw):
                if topic.key not in self._reading:
                    self._reading.add(topic.key)
                    self._subscribe(session, topic, raw)
            if raw and "*" in expression:
                self._kept += Strangers(self.put, self.prefix, expression, self._topics, self._clock).declare(session)

    def _subscribe(self, session: zenoh.Session, topic: Topic, raw: bool) -> None:
        reader: Reader
        if topic.delivery == "lossless":
            reader = Lossless(self.put, self._later, self.prefix, topic, raw, self._clock)
            self._direct[self.prefix + topic.key] = reader
        else:
            kind = Reader if raw else Newest
            reader = kind(self.put, self.prefix, topic, self._clock)
        self._kept += reader.declare(session)

    def receive(self, timeout: float) -> Event | Any | None:
        if not self._announced:
            self._announce()
        ready = self._ready
        end = time.monotonic() + timeout
        wait = timeout
        while not ready:
            if self._timers:
                wait = min(wait, self._handle_timers())
            try:
                item = self._get(wait > 0, wait)
            except queue.Empty:
                wait = end - time.monotonic()
                if wait > 0:
                    continue
                return None
            if type(item) is zenoh.Sample:
                reader = self._direct[str(item.key_expr)]
                event = reader.next_event(item)
                if event is not None:
                    return event
                reader.read(item, ready)
            elif item is None:
                return None
            else:
                item.handle(ready)
            wait = max(0.0, end - time.monotonic())
        return ready.popleft()

    def _handle_timers(self) -> float:
        """Handle what is due; return the seconds until the next is."""
        while self._timers and self._timers[0][0] <= time.monotonic():
            heapq.heappop(self._timers)[2].handle(self._ready)
        if self._ready or not self._timers:
            return 0.0
        return self._timers[0][0] - time.monotonic()

    def _later(self, seconds: float, item: Item) -> None:
        heapq.heappush(self._timers, (time.monotonic() + seconds, next(self._timer_numbers), item))

    def call(self, key: str, request: Message, timeout: float) -> int:
        call = self._call_to_make(key, request)
        self._calls_made += 1
        pending = Pending(self.put, call, self._calls_made, timeout)
        self._opened().get(
            self.prefix + key,
            Callback(pending.replied, pending.finished, indirect=False),
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout,
            congestion_control=zenoh.CongestionControl.BLOCK,
            payload=encode(request),
            encoding=encoding_of(call.request),
            attachment=pack(pending.token, self._clock.wall(), self._origin),
        )
        return pending.token

    def serve(self, key: str) -> None:
        call = self._call_to_serve(key)

        def asked(query: zenoh.Query) -> None:
            self.put(Asked(call, query, self._next_request))

        self._kept.append(self._opened().declare_queryable(self.prefix + key, Callback(asked, indirect=False), complete=True))

    def watch(self) -> None:
        if self._watching:
            return
        self._watching = True

        def changed(sample: zenoh.Sample) -> None:
            self.put(LivelinessChange(sample))

        liveliness = self._opened().liveliness()
        self._kept.append(
            liveliness.declare_subscriber(self._alive_prefix + "*", Callback(changed, indirect=False), history=True)
        )

    def has_reader(self, key: str) -> bool:
        self._declared(key)
        with self._opened().declare_publisher(self.prefix + key) as publisher:
            return publisher.matching_status.matching  # type: ignore[attr-defined]  # the stub says bool

    def wake(self) -> None:
        self.put(None)

    def post(self, event: object) -> None:
        self.put(Posted(event))

    def close(self) -> None:
        session, self._session = self._session, None
        self._announced = False
        _open_buses.discard(self)
        # A forked child holds a copy of the session without its threads: closing that would wait for ever.
        if session is None or os.getpid() != self._process:
            return
        # With a stopped process on the other side Zenoh takes up to ten seconds to say goodbye; nobody waits that long.
        goodbye = threading.Thread(target=_close, args=(session,), daemon=True, name="vantage-bus-close")
        goodbye.start()
        goodbye.join(CLOSE_TIME)
        self._kept.clear()
        self._writers.clear()

    def _next_request(self) -> int:
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
        encoding=encoding_of(topic.type),
        # Never BLOCK: it waits for seconds and then closes the transport. What is dropped is fetched from the cache.
        congestion_control=zenoh.CongestionControl.DROP,
        cache=ext.CacheConfig(kept) if kept else None,
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=HEARTBEAT, sporadic_heartbeat=None) if lossless else None,
        publisher_detection=True,
    )


def _close(session: zenoh.Session) -> None:
    with contextlib.suppress(zenoh.ZError):
        session.close()


_open_buses: set[ZenohBus] = set()


@atexit.register
def _close_all() -> None:
    for bus in list(_open_buses):
        bus.close()
