"""The bus inside one thread: deterministic, first in first out, and cheap, for tests and for `vantage collect`.

A published message is handed to its readers as the very object: frozen, and neither encoded (until somebody wants its bytes)
nor decoded. Nothing happens between two calls of a session, so `receive` never waits.
"""

from __future__ import annotations

import heapq
import time
from collections import deque
from collections.abc import Callable, Mapping
from itertools import islice
from typing import Any

from schemas import CALLS, TOPICS, Call, Message, Topic, encode
from vantage.bus.interface import Alive, Bus, CannotOpen, Event, NameInUse, Reply, Request, Sample, wrong_type

Put = Callable[[Sample], None]


class VirtualClock:
    """A clock that stands until it is moved. Nanoseconds since the Unix epoch."""

    def __init__(self, now: int = 1_000_000_000_000_000_000) -> None:
        self.now = now

    def __call__(self) -> int:
        return self.now

    def advance(self, seconds: float) -> None:
        """Move forward by `seconds`; moving back raises ValueError."""
        if seconds < 0:
            raise ValueError(f"a clock does not run backwards: advance({seconds})")
        self.now += round(seconds * 1e9)


class _Newest:
    """The one unread message of a `latest` topic; it stands in the queue once, however often it is overwritten."""

    __slots__ = ("_queue", "sample")

    def __init__(self, queue: deque[Event | _Newest | None]) -> None:
        self._queue = queue
        self.sample: Sample | None = None

    def put(self, sample: Sample) -> None:
        if self.sample is None:
            self._queue.append(self)
        self.sample = sample


class _Route:
    """What one session needs to publish one key, looked up once."""

    __slots__ = ("history", "kind", "readers", "sequence", "topic")

    def __init__(self, topic: Topic, readers: list[Put], history: deque[Sample] | None) -> None:
        self.topic = topic
        self.kind = topic.type
        self.readers = readers
        self.history = history
        self.sequence = 0


class InProcessNetwork:
    """The participants of one arena within one thread.

    Args:
        clock: nanoseconds; stamps what is published and judges the calls' time-outs.
        checked: take every message through the codec, as on the wire, so that one out of bounds is malformed here too (slower).
    """

    def __init__(
        self,
        arena: str = "table",
        clock: Callable[[], int] = time.time_ns,
        *,
        checked: bool = False,
        topics: Mapping[str, Topic] = TOPICS,
        calls: Mapping[str, Call] = CALLS,
    ) -> None:
        self.arena = arena
        self.clock = clock
        self.checked = checked
        self.topics = topics
        self.calls = calls
        self.sessions: dict[str, InProcessBus] = {}
        self.readers: dict[str, list[Put]] = {key: [] for key in topics}
        self.histories: dict[str, dict[str, deque[Sample]]] = {key: {} for key in topics}
        self.servers: dict[str, InProcessBus] = {}

    def session(self, name: str) -> InProcessBus:
        """Return a new participant's session. Raises NameInUse while one of that name is open."""
        if name in self.sessions:
            raise NameInUse(f"{name!r} is on the bus already: close that session first")
        session = InProcessBus(self, name)
        self.sessions[name] = session
        self._announce(Alive(name, True))
        return session

    def next_deadline(self) -> int | None:
        """Return the clock time at which the next outstanding call times out; None when none is outstanding."""
        return min((due for session in self.sessions.values() for due, _ in session.outstanding()), default=None)

    def left(self, session: InProcessBus) -> None:
        """Forget a session that closes: its latched messages, its servers, its place."""
        del self.sessions[session.name]
        for histories in self.histories.values():
            histories.pop(session.name, None)
        for key in [key for key, server in self.servers.items() if server is session]:
            del self.servers[key]
        for other in self.sessions.values():
            other.server_left(session)
        self._announce(Alive(session.name, False))

    def _announce(self, event: Alive) -> None:
        for session in self.sessions.values():
            session.heard(event)


class InProcessBus(Bus):
    """A session of an InProcessNetwork; made by its `session`."""

    def __init__(self, network: InProcessNetwork, name: str) -> None:
        super().__init__(name, network.arena, network.topics, network.calls)
        self._network = network
        self._clock = network.clock
        self._checked = network.checked
        self._queue: deque[Any] = deque()  # events, `_Newest`, what was posted, None for `wake`
        self._routes: dict[str, _Route] = {}
        self._reading: dict[str, Put] = {}
        self._watching = False
        self._calls_made = 0
        self._requests_made = 0
        self._pending: dict[int, tuple[Call, InProcessBus, int, float]] = {}
        self._deadlines: list[tuple[int, int]] = []
        self._open = True

    def publish(self, key: str, message: Message) -> None:
        route = self._routes.get(key) or self._route(key)
        if type(message) is not route.kind:
            raise wrong_type(route.topic, message)
        if self._checked:
            sample = Sample(key, encode(message), self.name, route.sequence, self._clock(), route.kind)
        else:
            sample = Sample(key, None, self.name, route.sequence, self._clock(), None, message)
        route.sequence += 1
        if route.history is not None:
            route.history.append(sample)
        for put in route.readers:
            put(sample)

    def _route(self, key: str) -> _Route:
        self._require_open()
        topic = self._topic_to_publish(key)
        history: deque[Sample] | None = None
        kept = max(topic.cache, topic.history) if topic.delivery == "lossless" else topic.history
        if kept:
            history = self._network.histories[key].setdefault(self.name, deque(maxlen=kept))
        route = self._routes[key] = _Route(topic, self._network.readers[key], history)
        return route

    def subscribe(self, *expressions: str, raw: bool = False) -> None:
        self._require_open()
        named = [topic for expression in expressions for topic in self._topics_to_subscribe(expression, raw)]
        for topic in named:
            if topic.key in self._reading:
                continue
            put: Put = self._queue.append if raw or topic.delivery == "lossless" else _Newest(self._queue).put
            self._reading[topic.key] = put
            self._network.readers[topic.key].append(put)
            for history in self._network.histories[topic.key].values():
                for sample in islice(history, 0 if raw else max(0, len(history) - topic.history), None):
                    put(sample)

    def receive(self, timeout: float) -> Event | Any | None:
        if self._deadlines:
            self._expire()
        if not self._queue:
            self._require_open()
            return None
        event = self._queue.popleft()
        if type(event) is _Newest:
            sample, event.sample = event.sample, None
            return sample
        return event

    def call(self, key: str, request: Message, timeout: float) -> int:
        self._require_open()
        call = self._call_to_make(key, request)
        self._calls_made += 1
        token = self._calls_made
        server = self._network.servers.get(key)
        if server is None:
            self._queue.append(Reply(token, key, None, f"nobody serves `{key}`: is {call.server} running?", call.reply))
            return token
        due = self._clock() + round(timeout * 1e9)
        self._pending[token] = (call, server, due, timeout)
        heapq.heappush(self._deadlines, (due, token))
        server.asked(call, encode(request), self, token)
        return token

    def serve(self, key: str) -> None:
        self._require_open()
        self._call_to_serve(key)
        self._network.servers[key] = self

    def watch(self) -> None:
        self._require_open()
        if not self._watching:
            self._watching = True
            self._queue.extend(Alive(name, True) for name in self._network.sessions)

    def has_reader(self, key: str) -> bool:
        self._declared(key)
        return bool(self._network.readers[key])

    def wake(self) -> None:
        self._queue.append(None)

    def post(self, event: object) -> None:
        self._queue.append(event)

    def close(self) -> None:
        if not self._open:
            return
        self._open = False
        for key, put in self._reading.items():
            # In place: the publishers' routes hold this very list.
            readers = self._network.readers[key]
            del readers[next(place for place, reader in enumerate(readers) if reader is put)]
        self._reading.clear()
        self._routes.clear()
        self._pending.clear()
        self._deadlines.clear()
        self._queue.clear()
        self._network.left(self)

    def _require_open(self) -> None:
        if not self._open:
            raise CannotOpen(f"the session of {self.name!r} is closed")

    def outstanding(self) -> list[tuple[int, int]]:
        """Return (due time, token) of every call without a Reply yet."""
        return [(due, token) for token, (_, _, due, _) in self._pending.items()]

    def heard(self, event: Alive) -> None:
        """Take note of a participant that came or went."""
        if self._watching:
            self._queue.append(event)

    def asked(self, call: Call, payload: bytes, caller: InProcessBus, token: int) -> None:
        """Take a question."""
        self._requests_made += 1
        self._queue.append(_InProcessRequest(call, payload, caller, token, self._requests_made))

    def answered(self, token: int, payload: bytes | None, error: str) -> None:
        """Take an answer, unless it comes too late."""
        self._expire()
        pending = self._pending.pop(token, None)
        if pending is not None:
            self._queue.append(Reply(token, pending[0].key, payload, error, pending[0].reply))

    def server_left(self, server: InProcessBus) -> None:
        """End the calls that `server` will not answer any more."""
        for token, (call, asked, _, _) in list(self._pending.items()):
            if asked is server:
                self.answered(token, None, f"{call.server} left the bus before it answered `{call.key}`")

    def _expire(self) -> None:
        while self._deadlines and self._deadlines[0][0] <= self._clock():
            _, token = heapq.heappop(self._deadlines)
            pending = self._pending.pop(token, None)
            if pending is not None:
                call, _, _, timeout = pending
                error = f"{call.server} did not answer `{call.key}` within {timeout:g} s"
                self._queue.append(Reply(token, call.key, None, error, call.reply))


class _InProcessRequest(Request):
    __slots__ = ("_bus", "_caller_token")

    def __init__(self, call: Call, payload: bytes, bus: InProcessBus, caller_token: int, token: int) -> None:
        super().__init__(call, payload, bus.name, token)
        self._bus = bus
        self._caller_token = caller_token

    def _send(self, payload: bytes | None, error: str) -> None:
        self._bus.answered(self._caller_token, payload, error)

    def __del__(self) -> None:
        self.fail(f"the server dropped the request for `{self.key}` without an answer")
