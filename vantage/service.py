"""What a service is: a pure core that declares what it hears and says, and the runtime that puts it on a bus.

A core has no clock, no bus and no I/O: `step` turns one received event and the time into what is to be sent. The runtime
decodes at the door, counts what was malformed, lost or unexpected, reports health once a second and stops on SIGTERM.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

from schemas import CALLS, TOPICS, Episode, Health, InputHealth, MalformedMessage, Message
from vantage.bus import Alive, Bus, CannotOpen, InProcessNetwork, Lost, Reply, Request, Sample, VirtualClock

logger = logging.getLogger("vantage")

SECOND = 1_000_000_000
HEALTH_PERIOD = SECOND
STALE_PERIODS = 10
STALE_MINIMUM = 2.5
"""An input is stale in a running real-time game when it is older than 10 of its periods, and than 2.5 s."""

LAST_WORDS = 1.0
"""Seconds that a raw service goes on with what has arrived before it was stopped."""
MOST_INPUTS = 200
"""Keys that health tells apart; a raw service counts further ones together, as `**`."""


@dataclass(frozen=True, slots=True)
class Declaration:
    """What a service hears and says. The runtime subscribes and checks by it, deployments are checked by it.

    Attributes:
        inputs, outputs: short keys of the topic table.
        calls, serves: keys of the call table.
        heeds: services whose coming and going the core wants to know (`Changed`).
        raw: inputs are key expressions, and reach the core undecoded, as `vantage.bus.Sample` (the recorder).
    """

    name: str
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    calls: tuple[str, ...] = ()
    serves: tuple[str, ...] = ()
    heeds: tuple[str, ...] = ()
    raw: bool = False

    def __post_init__(self) -> None:
        named = self.outputs if self.raw else self.inputs + self.outputs
        undeclared = [key for key in named if key not in TOPICS] + [key for key in self.calls + self.serves if key not in CALLS]
        if undeclared:
            raise ValueError(f"{self.name}: not in the topic or call table: {', '.join(undeclared)}")


@dataclass(slots=True)
class Arrived:
    """A message came in."""

    key: str
    message: Message


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
    """A heeded service came or went."""

    service: str
    alive: bool


@dataclass(slots=True)
class Woken:
    """The time that `wake_at` named has come."""


Received = Arrived | Asked | Answered | Changed | Woken | Sample | Lost


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


Send = Publish | Ask | Answer | Refuse


class Unexpected(Exception):
    """Raised by a core for a well-formed message that makes no sense here: it is counted and set aside."""


class CannotStart(Exception):
    """Raised while a service is made: printed as one line, exit code 1."""


class Core(Protocol):
    """The behaviour of a service, without clock, bus or I/O.

    It may have `trouble`, a text that makes its health degraded while it is not empty, and `close`, called at the end.
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


class StepJoin:
    """Collects the messages of one step until all of `keys` are there, whatever order they come in.

    Different publishers are not ordered among each other: a pose of the next episode may come before the episode itself,
    so a few early messages are kept.
    """

    EARLY = 32

    def __init__(self, keys: tuple[str, ...]) -> None:
        self._keys = keys
        self._episode = 0
        self._next_step = 0
        self._waiting: OrderedDict[tuple[int, int], dict[str, Message]] = OrderedDict()

    @property
    def episode(self) -> int:
        """Number of the episode being joined, 0 before the first."""
        return self._episode

    def begin(self, episode: int) -> tuple[Message, ...] | None:
        """Turn to an episode. Returns its first step if that is already complete."""
        self._episode = episode
        self._next_step = 0
        for key in [key for key in self._waiting if key[0] < episode]:
            del self._waiting[key]
        for key in sorted(key for key in self._waiting if key[0] == episode):
            complete = self._take(key)
            if complete is not None:
                return complete
        return None

    def add(self, key: str, message: Message) -> tuple[Message, ...] | None:
        """Add a message; return the step's messages in the order of `keys` once all are there, else None.

        Raises:
            Unexpected: the message belongs to an earlier episode or step, or came twice.
        """
        place = (message.episode, message.step)
        if message.episode < self._episode or (message.episode == self._episode and message.step < self._next_step):
            raise Unexpected(f"{key} of episode {message.episode} step {message.step} came late")
        joined = self._waiting.setdefault(place, {})
        if key in joined:
            raise Unexpected(f"{key} of episode {message.episode} step {message.step} came twice")
        joined[key] = message
        if message.episode != self._episode or self._episode == 0:
            if len(self._waiting) > self.EARLY:
                self._waiting.popitem(last=False)
            return None
        return self._take(place)

    def _take(self, place: tuple[int, int]) -> tuple[Message, ...] | None:
        joined = self._waiting[place]
        if len(joined) < len(self._keys):
            return None
        del self._waiting[place]
        self._next_step = place[1] + 1
        return tuple(joined[key] for key in self._keys)


@dataclass(slots=True)
class _Input:
    """Running counts of one input, reported in health."""

    publisher: str = ""
    received: int = 0
    malformed: int = 0
    lost: int = 0
    last: int | None = None


@dataclass
class Runtime:
    """A core on a bus. `turn` handles one event; `run` loops until stopped.

    Attributes:
        clock: time in ns since the Unix epoch; virtual in process.
        health: whether to publish `health/{name}` once a second.
    """

    core: Core
    bus: Bus
    clock: Callable[[], int] = time.time_ns
    health: bool = True
    _inputs: dict[str, _Input] = field(default_factory=dict)
    _unexpected: int = 0
    _failed: int = 0
    _trouble: str = ""
    _running_game: bool = False
    _alive: dict[str, bool] = field(default_factory=dict)
    _tokens: dict[int, tuple[str, int]] = field(default_factory=dict)
    _requests: dict[int, Request] = field(default_factory=dict)
    _next_health: int = 0
    _started: int = 0
    _stopping: bool = False

    def __post_init__(self) -> None:
        declaration = self.core.declaration
        self._raw = declaration.raw
        self._outputs = frozenset(declaration.outputs)
        self._heeds = frozenset(declaration.heeds)
        self._inputs = {} if self._raw else {key: _Input() for key in declaration.inputs}
        self._started = self.clock()
        self._last_failure_logged = 0.0
        if declaration.inputs:
            self.bus.subscribe(*declaration.inputs, raw=self._raw)
        for key in declaration.serves:
            self.bus.serve(key)
        if declaration.heeds:
            self.bus.watch()

    def turn(self, timeout: float) -> bool:
        """Handle the next event, waiting at most `timeout` s for it. Returns whether there was one."""
        now = self.clock()
        if self.health and now >= self._next_health:
            self._next_health = now + HEALTH_PERIOD
            self.bus.publish(f"health/{self.core.declaration.name}", self.health_report("ok"))
        wake = self.core.wake_at()
        if wake is not None and wake <= now:
            # A core that always wants to go on must not starve its inputs.
            event = self.bus.receive(0.0)
            if event is not None:
                self._handle(event, now)
            self._step(Woken(), now)
            return True
        if wake is not None:
            timeout = min(timeout, (wake - now) / SECOND)
        if self.health:
            timeout = min(timeout, max(0.0, (self._next_health - now) / SECOND))
        event = self.bus.receive(timeout)
        if event is None:
            return False
        self._handle(event, self.clock())
        return True

    def drain(self) -> bool:
        """Handle everything that waits, without waiting. Returns whether there was anything."""
        active = False
        receive = self.bus.receive
        while (event := receive(0.0)) is not None:
            self._handle(event, self.clock())
            active = True
        wake = self.core.wake_at()
        if wake is not None and wake <= self.clock():
            self._step(Woken(), self.clock())
            active = True
        return active

    def run(self) -> None:
        """Loop until `stop` or SIGTERM."""
        while not self._stopping:
            self.turn(1.0)
        if self._raw:
            # What has arrived is recorded before the end; SIGKILL follows SIGTERM after 2 s.
            until = time.monotonic() + LAST_WORDS
            while time.monotonic() < until and (event := self.bus.receive(0.0)) is not None:
                self._handle(event, self.clock())
        if self.health:
            self.bus.publish(f"health/{self.core.declaration.name}", self.health_report("stopping"))

    def stop(self) -> None:
        """Make `run` return after the current event. May be called from a signal handler."""
        self._stopping = True
        self.bus.wake()

    def health_report(self, state: str) -> Health:
        """Return what the service has to say of itself now."""
        now = self.clock()
        inputs = []
        troubles = [f"{name} is not alive" for name in sorted(self._heeds) if not self._alive.get(name, False)]
        if own := getattr(self.core, "trouble", ""):
            troubles.append(own)
        for key, counts in self._inputs.items():
            age = None if counts.last is None else max(0.0, (now - counts.last) / SECOND)
            rate = TOPICS[key].rate if key in TOPICS else 0.0
            flowing = rate > 0 and self._running_game and not key.startswith("health/")
            stale = flowing and age is not None and age > max(STALE_PERIODS / rate, STALE_MINIMUM)
            if stale:
                troubles.append(f"{key} from {counts.publisher or 'nobody'} is {age:.1f} s old, expected {rate:g} a second")
            inputs.append(
                InputHealth(
                    key=key,
                    publisher=counts.publisher,
                    received=counts.received,
                    malformed=counts.malformed,
                    lost=counts.lost,
                    age=age,
                    stale=stale,
                )
            )
        if troubles and state == "ok":
            state = "degraded"
        reason = "; ".join([*troubles, self._trouble] if self._trouble else troubles)
        return Health(
            stamp=now,
            service=self.core.declaration.name,
            state=state,  # type: ignore[arg-type]
            process=os.getpid(),
            uptime=max(0.0, (now - self._started) / SECOND),
            inputs=tuple(inputs[:256]),
            unexpected=self._unexpected,
            failed=self._failed,
            reason=reason[:2000],
        )

    def _handle(self, event: Any, now: int) -> None:
        if type(event) is Sample:
            self._handle_sample(event, now)
        elif isinstance(event, Request):
            self._handle_request(event, now)
        elif isinstance(event, Reply):
            self._handle_reply(event, now)
        elif isinstance(event, Lost):
            counts = self._inputs.setdefault(event.key, _Input(publisher=event.publisher))
            counts.lost += event.missed
            if self._raw:
                self._step(event, now)
        elif isinstance(event, Alive) and event.name in self._heeds and self._alive.get(event.name) != event.alive:
            self._alive[event.name] = event.alive
            self._step(Changed(event.name, event.alive), now)

    def _handle_sample(self, sample: Sample, now: int) -> None:
        counts = self._counts_of(sample)
        if self._raw:
            counts.received += 1
            counts.last = now
            counts.publisher = sample.publisher
            self._step(sample, now)
            return
        try:
            message = sample.decode()
        except MalformedMessage as error:
            self._set_aside_malformed(sample, error)
            return
        counts.received += 1
        topic = TOPICS.get(sample.key)
        if topic is not None and sample.publisher not in topic.publishers:
            # A stranger's episode with an absurd number would make us deaf to the real ones.
            self._unexpected += 1
            self._trouble = f"set aside: {sample.key} from {sample.publisher or 'a stranger'}, who may not publish it"
            return
        counts.last = now
        counts.publisher = sample.publisher
        if type(message) is Episode:
            self._running_game = message.phase == "running" and message.rules.step_period > 0
        self._step(Arrived(sample.key, message), now)

    def _counts_of(self, sample: Sample) -> _Input:
        counts = self._inputs.get(sample.key)
        if counts is None:
            # Strangers may publish on any number of keys; health stays small.
            key = sample.key if sample.key in TOPICS or len(self._inputs) < MOST_INPUTS else "**"
            counts = self._inputs.setdefault(key[:200], _Input())
        return counts

    def _set_aside_malformed(self, sample: Sample, error: MalformedMessage) -> None:
        self._counts_of(sample).malformed += 1
        self._trouble = f"{sample.key} from {sample.publisher or 'an unknown publisher'} was malformed: {error}"

    def _handle_request(self, request: Request, now: int) -> None:
        counts = self._inputs.setdefault(request.key, _Input())
        counts.publisher = request.caller
        try:
            message = request.decode()
        except MalformedMessage as error:
            counts.malformed += 1
            request.fail(str(error))
            return
        counts.received += 1
        counts.last = now
        token = request.token
        self._requests[token] = request
        if not self._step(Asked(request.key, message, token), now) and token in self._requests:
            self._requests.pop(token).fail(f"{self.core.declaration.name} could not handle this request: {self._trouble}")

    def _handle_reply(self, reply: Reply, now: int) -> None:
        known = self._tokens.pop(reply.token, None)
        if known is None:
            return
        key, token = known
        error = reply.error
        message: Message | None = None
        if not error:
            try:
                message = reply.decode()
            except MalformedMessage as malformed:
                error = str(malformed)
        self._step(Answered(key, token, message, error), now)

    def _step(self, received: Received, now: int) -> bool:
        try:
            for send in self.core.step(received, now):
                self._send(send)
        except Unexpected as unexpected:
            self._unexpected += 1
            self._trouble = f"set aside: {unexpected}"
            return False
        except Exception as error:  # a service never dies of a message
            if self._raw and isinstance(error, MalformedMessage) and type(received) is Sample:
                self._set_aside_malformed(received, error)
                return False
            self._failed += 1
            self._trouble = f"{type(error).__name__}: {error}"
            if time.monotonic() - self._last_failure_logged > 1.0:
                self._last_failure_logged = time.monotonic()
                logger.exception("%s: handling %s failed", self.core.declaration.name, type(received).__name__)
            return False
        return True

    def _send(self, send: Send) -> None:
        if type(send) is Publish:
            if send.key not in self._outputs:
                raise ValueError(f"{self.core.declaration.name} does not declare {send.key} as an output")
            self.bus.publish(send.key, send.message)
        elif isinstance(send, Ask):
            self._tokens[self.bus.call(send.key, send.request, send.timeout)] = (send.key, send.token)
        elif isinstance(send, Answer):
            request = self._requests.pop(send.token, None)
            if request is not None:
                request.reply(send.reply)
        elif isinstance(send, Refuse):
            request = self._requests.pop(send.token, None)
            if request is not None:
                request.fail(send.reason)


def run_in_process(network: InProcessNetwork, runtimes: Sequence[Runtime], until: Callable[[], bool]) -> None:
    """Run services in one thread, each in turn, deterministically, until `until()` is true.

    When nobody has anything to do, the network's clock (a VirtualClock) jumps to the next time that a core wants to be woken or
    a call is due.

    Raises:
        RuntimeError: nothing is left to do although `until()` is false.
    """
    clock = network.clock
    assert isinstance(clock, VirtualClock)
    while not until():
        active = False
        for runtime in runtimes:
            active |= runtime.drain()
        if not active:
            wakes = [runtime.core.wake_at() for runtime in runtimes] + [network.next_deadline()]
            due = [wake for wake in wakes if wake is not None]
            if not due:
                raise RuntimeError("the services are all idle, and what was waited for has not come")
            clock.now = max(clock.now, min(due))


@dataclass(frozen=True)
class BusSettings:
    """Where the bus is."""

    folder: Path = Path()
    """Private folder of the deployment, which holds the sockets."""
    arena: str = "table"
    """Name of the arena: all keys stand below vantage/ARENA/."""


@contextmanager
def _stop_on_signal(runtime: Runtime) -> Iterator[None]:
    def handle(_number: int, _frame: FrameType | None) -> None:
        runtime.stop()

    previous = {number: signal.signal(number, handle) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def run(make_core: Callable[[], Core], name: str, settings: BusSettings) -> int:
    """Run one service as a process on Zenoh until SIGTERM. Returns the exit code.

    What is wrong at the start (missing weights, a taken name, an impossible layout) is said in one line.
    """
    from vantage.bus.zenoh_bus import ZenohBus  # only a process on a real bus pays for loading Zenoh

    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr)
    with ExitStack() as closing:
        try:
            core = make_core()
            if hasattr(core, "close"):
                closing.callback(core.close)
            bus = closing.enter_context(ZenohBus(name, settings.folder, settings.arena))
        except (CannotStart, CannotOpen, ValueError, OSError) as error:
            print(f"{name} cannot start: {error}", file=sys.stderr)
            return 1
        runtime = Runtime(core, bus)
        with _stop_on_signal(runtime):
            logger.info("%s started", name)
            runtime.run()
    logger.info("%s stopped", name)
    return 0
