"""The runtime: puts a core on a bus, decodes at the door, keeps account of the service's condition, reports health."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from schemas import TOPICS, Episode, Health, MalformedMessage, Message
from vantage.bus import Alive, Bus, Lost, Reply, Request, Sample
from vantage.bus.clock import MACHINE
from vantage.printable import printable
from vantage.service.condition import Condition
from vantage.service.core import (
    SECOND,
    Answer,
    Answered,
    Arrived,
    Ask,
    Asked,
    Changed,
    Core,
    Publish,
    Received,
    Refuse,
    Send,
    Unexpected,
    Woken,
)
from vantage.service.device import Captured, Device, DeviceThread, Write

logger = logging.getLogger("vantage")

HEALTH_PERIOD = SECOND
LONGEST_WAIT = 0.1
"""Seconds that the loop waits for an event at most: how late it comes back tells whether the machine is too slow."""
HELD_UP = SECOND // 10
"""ns by which the loop may come late without its core being told."""
MOST_BEFORE_TIME = 100
"""Events that are handled before a core is woken, at most: what came in time is heard before time is up."""
LAST_WORDS = 1.0
"""Seconds that a raw service goes on with what has arrived before it was stopped."""


def steady_clock() -> int:
    """Return ns since the Unix epoch as it was when the process started: the clock that timers need never steps back."""
    return MACHINE.wall()


@dataclass
class Runtime:
    """A core on a bus. `turn` handles one event; `run` loops until stopped.

    Attributes:
        clock: time in ns since the Unix epoch; virtual in process.
        health: whether to publish `health/{name}` once a second.
        devices: of the service: opened and read while `run` runs.
    """

    core: Core
    bus: Bus
    clock: Callable[[], int] = steady_clock
    health: bool = True
    devices: Sequence[Device] = ()
    _tokens: dict[int, tuple[str, int]] = field(default_factory=dict)
    _requests: dict[int, Request] = field(default_factory=dict)
    _next_health: int = 0
    _due_back: int | None = None  # when the loop ought to be back at its start
    _stopping: bool = False

    def __post_init__(self) -> None:
        declaration = self.core.declaration
        self._raw = declaration.raw
        self._held_up = getattr(self.core, "held_up", None)
        self._outputs = frozenset(declaration.outputs)
        self._heeds = frozenset(declaration.participants)
        self._devices = {device.name: device for device in self.devices}
        self._threads = [DeviceThread(device, self.bus.post, self.clock) for device in self.devices]
        self._condition = Condition(self.core, self.clock())
        self._last_failure_logged = 0.0
        if declaration.inputs:
            self.bus.subscribe(*declaration.inputs, raw=self._raw)
        for key in declaration.serves:
            self.bus.serve(key)
        if self._heeds:
            self.bus.watch()

    def turn(self, timeout: float) -> bool:
        """Handle the next event, waiting at most `timeout` s for it. Returns whether there was one."""
        now = self.clock()
        self._note_delay(now)
        if self.health and now >= self._next_health:
            self._next_health = now + HEALTH_PERIOD
            self.bus.publish(f"health/{self.core.declaration.name}", self.health_report("ok"))
        wake = self.core.wake_at()
        if wake is not None and wake <= now:
            # A core that always wants to go on must not starve its inputs, nor one that was held up miss what came in time.
            for _ in range(MOST_BEFORE_TIME):
                if (event := self.bus.receive(0.0)) is None:
                    break
                self._handle(event, self.clock())
            self._step(Woken(), self.clock())
            self._due_back = self.clock()
            return True
        if wake is not None:
            timeout = min(timeout, (wake - now) / SECOND)
        if self.health:
            timeout = min(timeout, max(0.0, (self._next_health - now) / SECOND))
        due = now + round(timeout * SECOND)
        event = self.bus.receive(timeout)
        back = self.clock()
        if self._held_up is None:
            self._condition.woken(late=back - due, now=back)
        self._due_back = min(due, back)
        if event is None:
            return False
        self._handle(event, back)
        return True

    def _note_delay(self, now: int) -> None:
        """Let the core know for how long it could not look: neither the machine nor its own work let it."""
        due, self._due_back = self._due_back, None
        if self._held_up is not None and due is not None and now - due > HELD_UP:
            self._condition.woken(late=now - due, now=now)
            self._held_up(now - due, now)

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
        for thread in self._threads:
            thread.start()
        try:
            while not self._stopping:
                self.turn(LONGEST_WAIT)
        finally:
            for thread in self._threads:
                thread.stop()
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
        return self._condition.report(state, self.clock())

    def _handle(self, event: Any, now: int) -> None:
        if type(event) is Sample:
            self._handle_sample(event, now)
        elif isinstance(event, Request):
            self._handle_request(event, now)
        elif isinstance(event, Reply):
            self._handle_reply(event, now)
        elif isinstance(event, Lost):
            self._condition.counts_of(event.key, event.publisher).lost += event.missed
            if self._raw:
                self._step(event, now)
        elif isinstance(event, DeviceThread):
            if (captured := event.take()) is not None:
                self._step(captured, now)
        elif isinstance(event, Captured):
            self._step(event, now)
        elif isinstance(event, Alive) and event.name in self._heeds and self._condition.hears_of(event.name, event.alive):
            self._step(Changed(event.name, event.alive), now)

    def _handle_sample(self, sample: Sample, now: int) -> None:
        condition = self._condition
        counts = condition.counts_of(sample.key)
        if self._raw:
            counts.received += 1
            counts.last = now
            counts.publisher = sample.publisher
            self._step(sample, now)
            return
        try:
            message = sample.decode()
        except MalformedMessage as error:
            condition.malformed(sample.key, sample.publisher, error, now)
            return
        counts.received += 1
        topic = TOPICS.get(sample.key)
        if topic is not None and sample.publisher not in topic.publishers:
            # A stranger's episode with an absurd number would make us deaf to the real ones.
            condition.set_aside(f"{sample.key} from {sample.publisher or 'a stranger'}, who may not publish it", now)
            return
        counts.last = now
        counts.publisher = sample.publisher
        if type(message) is Episode:
            condition.expects_flow(message.phase == "running" and not message.paused and message.rules.step_period > 0, now)
        self._step(Arrived(sample.key, message, sample.sent), now, sample.publisher)

    def _handle_request(self, request: Request, now: int) -> None:
        counts = self._condition.counts_of(request.key)
        counts.publisher = request.caller
        try:
            message = request.decode()
        except MalformedMessage as error:
            self._condition.malformed(request.key, request.caller, error, now)
            request.fail(str(error))
            return
        counts.received += 1
        counts.last = now
        token = request.token
        self._requests[token] = request
        if not self._step(Asked(request.key, message, token), now, request.caller) and token in self._requests:
            self._requests.pop(token).fail(
                f"{self.core.declaration.name} could not handle this request: {self._condition.trouble}"
            )

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

    def _step(self, received: Received, now: int, publisher: str = "") -> bool:
        try:
            for send in self.core.step(received, now):
                self._send(send)
        except Unexpected as unexpected:
            self._condition.set_aside(f"{_described(received, publisher)}: {unexpected}", now)
            return False
        except Exception as error:  # a service never dies of a message
            if self._raw and isinstance(error, MalformedMessage) and type(received) is Sample:
                self._condition.malformed(received.key, received.publisher, error, now)
                return False
            described = _described(received, publisher)
            self._condition.fail(f"{described}: {type(error).__name__}: {error}", now)
            if time.monotonic() - self._last_failure_logged > 1.0:
                self._last_failure_logged = time.monotonic()
                logger.exception("%s: handling %s failed", self.core.declaration.name, printable(described))
            return False
        return True

    def _send(self, send: Send) -> None:
        if type(send) is Publish:
            if send.key not in self._outputs:
                raise ValueError(f"{self.core.declaration.name} does not declare {send.key} as an output")
            self.bus.publish(send.key, send.message)
        elif isinstance(send, Write):
            self._devices[send.device].write(send.data)
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


def _described(received: Received, publisher: str) -> str:
    """Return what an event is, in the words of a log: the key and who published it."""
    if isinstance(received, Sample | Lost):
        publisher = received.publisher
    key = getattr(received, "key", "")
    if key:
        return f"{key} from {publisher}" if publisher else key
    return f"device {received.device}" if isinstance(received, Captured) else type(received).__name__.lower()
