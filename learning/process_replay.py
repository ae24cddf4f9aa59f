"""Process replay: a recorded log, fed to one service alone, must give the recorded outputs (after openpilot).

Stamps of the clock and times taken differ from run to run and are left out of the comparison, nothing else. The clock itself is
no input that a log could hold: where a core waits for a time, it is woken when the log says that it spoke.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from msgspec.structs import fields as fields_of
from msgspec.structs import replace

from schemas import MalformedMessage, Message, PredictReply, PredictRequest
from services.planner.core import PlannerCore, PlannerSettings
from services.referee.core import RefereeCore, RefereeSettings
from services.seeker.core import SeekerCore
from vantage.log.reader import Record, read
from vantage.service import SECOND, Answered, Arrived, Ask, Changed, Core, Publish, Received, Unexpected, Woken

CLOCK_FIELDS = ("stamp", "elapsed")
LATEST = 10 * SECOND
"""No message takes longer than this to the recorder."""


@dataclass
class Comparison:
    """How one output of a service compares.

    Attributes:
        compared: messages that were recorded or said again.
        differences: in words, the first few.
    """

    key: str
    compared: int = 0
    differences: list[str] = field(default_factory=list)


def replayable() -> dict[str, Callable[[], Core]]:
    """Return the services whose outputs follow from the log alone."""
    return {
        "seeker": SeekerCore,
        "planner": lambda: PlannerCore(PlannerSettings()),
        "referee": lambda: RefereeCore(RefereeSettings(settle=0.0)),
    }


def without_clock(message: Message) -> Message:
    """Return the message with every stamp and time taken set to zero."""
    names = {entry.name for entry in fields_of(message)}
    return replace(message, **{name: 0 for name in CLOCK_FIELDS if name in names})


class ProcessReplay:
    """Feeds a log's messages to a core and keeps what it says.

    Calls are answered with the recorded answers: an `Ask` is matched with the recorded request of the same content.
    """

    def __init__(self, core: Core) -> None:
        self._core = core
        self._inputs = frozenset(core.declaration.inputs)
        self._asked: list[tuple[Ask, Message]] = []
        self._answers: list[tuple[Message, Message]] = []
        self._request: Message | None = None
        self.said: dict[str, list[Message]] = {key: [] for key in core.declaration.outputs if not key.startswith("health/")}
        self.recorded: dict[str, list[Message]] = {key: [] for key in self.said}
        for service in (name for names in core.declaration.heeds for name in names.split("|")):
            self._step(Changed(service, True), 0)

    def feed(self, record: Record) -> None:
        """Take one record of the log, in the order in which they were published."""
        try:
            message = record.decode()
        except MalformedMessage:
            return
        now = record.publish_time
        if record.key in self.recorded:
            self.recorded[record.key].append(message)
            self._wake_until_said(record.key, now)
        if isinstance(message, PredictRequest):
            self._request = without_clock(message)
        elif isinstance(message, PredictReply) and self._request is not None:
            self._answers.append((self._request, message))
            self._answer(now)
        if record.key in self._inputs:
            self._step(Arrived(record.key, message), now)

    def _wake_until_said(self, key: str, now: int) -> None:
        for _ in range(4):
            wake = self._core.wake_at()
            if wake is None or len(self.said[key]) >= len(self.recorded[key]):
                return
            self._step(Woken(), max(wake, now))

    def _step(self, received: Received, now: int) -> None:
        try:
            sends = self._core.step(received, now)
        except Unexpected:
            return
        for send in sends:
            if isinstance(send, Publish) and send.key in self.said:
                self.said[send.key].append(send.message)
            elif isinstance(send, Ask):
                self._asked.append((send, without_clock(send.request)))
                self._answer(now)

    def _answer(self, now: int) -> None:
        for ask, request in list(self._asked):
            for recorded, reply in self._answers:
                if recorded == request:
                    self._asked.remove((ask, request))
                    self._answers.remove((recorded, reply))
                    self._step(Answered(ask.key, ask.token, reply), now)
                    break

    def compare(self) -> list[Comparison]:
        """Return how every output compares, after the whole log has been fed."""
        return [_compare(key, self.said[key], self.recorded[key]) for key in self.said]


def _compare(key: str, said: Sequence[Message], recorded: Sequence[Message]) -> Comparison:
    comparison = Comparison(key, max(len(said), len(recorded)))
    if len(said) != len(recorded):
        comparison.differences.append(f"{len(recorded)} messages recorded, {len(said)} said again")
    for index, (new, old) in enumerate(zip(said, recorded, strict=False)):
        new, old = without_clock(new), without_clock(old)
        if new != old and len(comparison.differences) < 5:
            names = [entry.name for entry in fields_of(old) if getattr(old, entry.name) != getattr(new, entry.name, None)]
            place = f"message {index} (episode {old.episode}, step {old.step})"
            comparison.differences.append(f"{place} differs in {', '.join(names)}")
    return comparison


def in_order_of_publishing(records: Iterable[Record]) -> Iterator[Record]:
    """Yield the records of a log by the publishers' clock, which is one clock: a log has them in the order of their arrival."""
    waiting: list[tuple[int, int, Record]] = []
    for number, record in enumerate(records):
        heapq.heappush(waiting, (record.publish_time, number, record))
        while waiting[0][0] < record.log_time - LATEST:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]


def replay_service(path: Path, service: str) -> list[Comparison]:
    """Replay a log through one service.

    Raises:
        KeyError: the service cannot be replayed.
    """
    replay = ProcessReplay(replayable()[service]())
    for record in in_order_of_publishing(read(path)):
        replay.feed(record)
    return replay.compare()
