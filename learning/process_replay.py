"""Process replay: a recorded log, fed to one service alone, must give the recorded outputs (after openpilot).

The simulator is one of them: seed, rules and logged commands of a game, whoever gave them, make the same game again.

Stamps of the clock and times taken differ from run to run and are left out of the comparison, nothing else. The clock itself is
no input that a log could hold: where a core waits for a time, it is woken when the log says that it spoke.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field
from dataclasses import replace as with_changes
from pathlib import Path

from msgspec.structs import fields as fields_of
from msgspec.structs import replace

from learning.stretches import RefereeOfStretches
from schemas import Control, DepthImage, Episode, MalformedMessage, Message, PredictReply, PredictRequest, Tick
from services.planner.core import PlannerCore, PlannerSettings
from services.referee.core import RefereeCore, RefereeSettings
from services.referee.declaration import DECLARATION as REFEREE
from services.seeker.core import SeekerCore, SeekerSettings
from services.simulator.core import SimulatorCore, SimulatorSettings
from vantage.log.reader import Record, find_logs, open_log, read
from vantage.service import SECOND, Answered, Arrived, Ask, Changed, Core, Publish, Received, Unexpected, Woken
from vantage.world.camera import Camera

CLOCK_FIELDS = {"stamp": 0, "elapsed": 0, "request": ""}
"""What differs from run to run, and its replacement: times, and the random name of a wish, which a log may begin after."""
MOST_DIFFERENCES = 5
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


@dataclass(frozen=True)
class Contents:
    """What a log tells of the settings of the services that it was recorded with.

    Attributes:
        published: (key, publisher); the publisher is empty in a log that does not name them.
        begun: (first set-up, how many) of each stretch of games with consecutive numbers, where nobody asked for the first of
            them on the log: the referee began by itself.
        picture: the first depth picture.
    """

    published: frozenset[tuple[str, str]]
    begun: tuple[tuple[Episode, int], ...] = ()
    picture: DepthImage | None = None

    def has(self, key: str, service: str) -> bool:
        """Whether a service said something on a key."""
        return (key, service) in self.published or (key, "") in self.published


def contents_of(path: Path) -> Contents:
    """Return what a log, or the logs in a folder, tell of the services.

    Raises:
        FileNotFoundError: there is no log.
    """
    published = set()
    first: dict[str, Message] = {}
    setups: list[Episode] = []
    for parts in find_logs(path):
        with open_log(*parts) as log:
            channels = [channel for file in log.files for channel in file.channels.values()]
            published |= {(channel.topic, channel.metadata.get("publisher", "")) for channel in channels}
            for topics in (("control", "episode"), ("hider/depth",)):
                for record in log.records(topics):
                    if record.well_formed:
                        first.setdefault(topics[0], record.decode())
                        break
            begun = first.get("control")
            if isinstance(begun, Episode) and begun.phase == "setup":
                setups += _setups(log.records(("episode",)))
    picture = first.get("hider/depth")
    stretches: list[tuple[Episode, int]] = []
    for setup in setups:
        if stretches and setup.episode <= stretches[-1][0].episode + stretches[-1][1]:
            stretches[-1] = stretches[-1][0], stretches[-1][1] + 1
        else:
            stretches.append((setup, 1))
    return Contents(
        frozenset(published),
        tuple(stretches),
        picture if isinstance(picture, DepthImage) else None,
    )


def _setups(records: Iterable[Record]) -> Iterator[Episode]:
    for record in records:
        message = record.decode() if record.well_formed else None
        if isinstance(message, Episode) and message.phase == "setup":
            yield message


def replayable() -> dict[str, Callable[[Contents], Core]]:
    """Return the services whose outputs follow from the log alone."""
    return {"seeker": _seeker, "planner": lambda _: PlannerCore(PlannerSettings()), "referee": _referee, "simulator": _simulator}


def _seeker(contents: Contents) -> Core:
    return SeekerCore(SeekerSettings(publish_view=contents.has("seeker/view", "seeker")))


def _referee(contents: Contents) -> Core:
    # Where nobody wrote down that the console was alive, the games themselves say so.
    others = () if contents.has("health/console", "console") else ("console", "hider")
    settings = RefereeSettings(settle=0.0, required=(*REFEREE.heeds, *others))
    if not contents.begun:
        return RefereeCore(settings)
    played = [
        with_changes(
            settings,
            autoplay=True,
            games=games,
            seed=setup.seed,
            first_episode=setup.episode,
            rules=setup.rules,
            players=setup.players,
        )
        for setup, games in contents.begun
    ]
    played[-1] = with_changes(played[-1], games=0)  # the log does not say that there was to be none more
    return RefereeOfStretches(played)


def _simulator(contents: Contents) -> Core:
    picture = contents.picture
    if picture is None:
        return SimulatorCore()
    lens = picture.intrinsics
    camera = Camera(picture.width, picture.height, mount_height=lens.mount_height)
    if camera.intrinsics() != lens:
        camera = with_changes(camera, horizontal_fov=2.0 * math.atan(picture.width / (2.0 * lens.fx)))
    return SimulatorCore(SimulatorSettings(camera))


def without_clock(message: Message) -> Message:
    """Return the message without what differs from run to run: stamps, times taken, and the name of the wish for a game."""
    names = {entry.name for entry in fields_of(message)}
    return replace(message, **{name: value for name, value in CLOCK_FIELDS.items() if name in names})


MOST_HELD = 4096
"""Records between a question and its answer; beyond, the answer is taken as lost."""


class ProcessReplay:
    """Feeds a log's messages to a core and keeps what it says.

    Calls are answered with the recorded answers: an `Ask` is matched with the recorded request of the same content.
    """

    def __init__(self, core: Core) -> None:
        self._core = core
        self._inputs = frozenset(core.declaration.inputs)
        self._asked: list[tuple[Ask, Message]] = []
        self._answers: list[tuple[Message, Message]] = []
        self._requests: list[PredictRequest] = []
        # What a core hears as well comes from the log: the referee stops games by `control` when their owner leaves the bus, of
        # which a log does not tell.
        self._outputs = [
            key for key in core.declaration.outputs if not key.startswith("health/") and key not in core.declaration.inputs
        ]
        self._heeded = self._inputs | set(self._outputs) | {"predictor/request", "predictor/reply"}
        self._comparisons = {key: Comparison(key) for key in self._outputs}
        self._said: Counter[str] = Counter()
        self._recorded: Counter[str] = Counter()
        # (is it recorded, message) that the other side has not said yet; pictures are not kept longer than that.
        self._waiting: dict[str, deque[tuple[bool, Message]]] = {key: deque() for key in self._outputs}
        for service in core.declaration.participants:
            self._step(Changed(service, True), 0)

    def feed(self, record: Record) -> None:
        """Take one record of the log, in the order in which they were published."""
        if record.key not in self._heeded:
            return  # pictures of the other robot are not decoded for nothing
        try:
            message = record.decode()
        except MalformedMessage:
            return
        now = record.publish_time
        if record.key in self._waiting and record.publisher in (self._core.declaration.name, ""):
            self._recorded[record.key] += 1
            self._wake_until_said(record.key, now)
            self._compare(record.key, message, is_recorded=True)
        if isinstance(message, PredictRequest):
            self._requests.append(message)
        elif isinstance(message, PredictReply):
            self._pair(message, now)
        if record.key in self._inputs:
            self._step(Arrived(record.key, message), now)

    def _wake_until_said(self, key: str, now: int) -> None:
        for _ in range(4):
            wake = self._core.wake_at()
            if wake is None or self._said[key] >= self._recorded[key]:
                return
            self._step(Woken(), max(wake, now))

    def _step(self, received: Received, now: int) -> None:
        try:
            sends = self._core.step(received, now)
        except Unexpected:
            return
        for send in sends:
            if isinstance(send, Publish) and send.key in self._waiting:
                self._said[send.key] += 1
                self._compare(send.key, send.message, is_recorded=False)
            elif isinstance(send, Ask):
                self._asked.append((send, without_clock(send.request)))
                self._answer(now)

    def _pair(self, reply: PredictReply, now: int) -> None:
        """Several may ask at once: a reply belongs to the request of its place and size."""
        for request in self._requests:
            size = 4 * request.path_count * len(request.horizons)
            asked = (request.stamp, request.episode, request.step, size, len(request.views))
            if asked == (reply.stamp, reply.episode, reply.step, len(reply.caught), len(reply.views)):
                self._requests.remove(request)
                self._answers.append((without_clock(request), reply))
                self._answer(now)
                return

    def _answer(self, now: int) -> None:
        for ask, request in list(self._asked):
            for recorded, reply in self._answers:
                if recorded == request:
                    self._asked.remove((ask, request))
                    self._answers.remove((recorded, reply))
                    self._step(Answered(ask.key, ask.token, reply), now)
                    break

    def _compare(self, key: str, message: Message, *, is_recorded: bool) -> None:
        """Compare with what the other side said, or keep until it does."""
        waiting = self._waiting[key]
        if not waiting or waiting[0][0] == is_recorded:
            waiting.append((is_recorded, message))
            return
        _, other = waiting.popleft()
        new, old = (other, message) if is_recorded else (message, other)
        comparison = self._comparisons[key]
        place = f"message {comparison.compared} (episode {old.episode}, step {old.step})"
        comparison.compared += 1
        new, old = without_clock(new), without_clock(old)
        if new != old and len(comparison.differences) < MOST_DIFFERENCES:
            names = [entry.name for entry in fields_of(old) if getattr(old, entry.name) != getattr(new, entry.name, None)]
            comparison.differences.append(f"{place} differs in {', '.join(names)}")

    def compare(self) -> list[Comparison]:
        """Return how every output compares, after the whole log has been fed."""
        for key, comparison in self._comparisons.items():
            recorded, said = self._recorded[key], self._said[key]
            if recorded != said:
                comparison.compared = max(recorded, said)
                comparison.differences.insert(0, f"{recorded} messages recorded, {said} said again")
        return list(self._comparisons.values())


def in_order_of_publishing(records: Iterable[Record]) -> Iterator[Record]:
    """Yield the records of a log by the publishers' clock, which is one clock: a log has them in the order of their arrival."""
    waiting: list[tuple[int, int, Record]] = []
    for number, record in enumerate(records):
        heapq.heappush(waiting, (record.publish_time, number, record))
        while waiting[0][0] < record.log_time - LATEST:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]


def pauses_as_heard(records: Iterable[Record]) -> Iterator[Record]:
    """Yield records with every pause behind the tick that the referee gave before it heard of it: it was on its way."""
    held: list[Record] = []  # a pause and what was published after it, up to the referee's next word
    for record in records:
        if held or (record.key == "control" and _action(record) == "pause"):
            held.append(record)
            if record.key not in ("tick", "episode"):
                continue
            message = record.decode() if record.well_formed else None
            if isinstance(message, Tick) and not message.late:
                held = [*held[1:], held[0]]
            yield from held
            held = []
        else:
            yield record
    yield from held


def answers_as_heard(records: Iterable[Record]) -> Iterator[Record]:
    """Yield records with every answer to the planner before the plan that was made of it: the predictor first answers, and then
    tells everybody that it did.
    """
    held: list[Record] = []  # a question of the planner's and what was published after it, up to the answer
    for record in records:
        if record.key == "predictor/reply" and held and not _asks_for_views(record):
            place = next((place for place, other in enumerate(held) if other.key == "hider/plan"), len(held))
            held.insert(place, record)
        elif held or (record.key == "predictor/request" and not _asks_for_views(record)):
            held.append(record)
            if len(held) < MOST_HELD:
                continue
        else:
            held.append(record)
        yield from held
        held = []
    yield from held


def _asks_for_views(record: Record) -> bool:
    """Whether a question or an answer is of somebody who looks at single goals; the planner asks for no views."""
    message = record.decode() if record.well_formed else None
    return not isinstance(message, PredictRequest | PredictReply) or bool(message.views)


def _action(record: Record) -> str:
    message = record.decode() if record.well_formed else None
    return message.action if isinstance(message, Control) else ""


def replay_services(contents: Contents, records: Iterable[Record], services: Collection[str]) -> dict[str, list[Comparison]]:
    """Replay a log's records through services, all at once; nothing for one of which the log holds nothing (`why_silent`).

    Raises:
        KeyError: a service cannot be replayed.
    """
    cores = {service: replayable()[service](contents) for service in services}
    replays = {
        service: ProcessReplay(core)
        for service, core in cores.items()
        if any(contents.has(key, service) for key in core.declaration.outputs if not key.startswith("health/"))
    }
    for record in answers_as_heard(pauses_as_heard(in_order_of_publishing(records))):
        for replay in replays.values():
            replay.feed(record)
    return {service: replays[service].compare() if service in replays else [] for service in cores}


def replay_service(path: Path, service: str) -> list[Comparison]:
    """Replay a log through one service; nothing where the log holds nothing that it said (`why_silent`).

    Raises:
        KeyError: the service cannot be replayed.
    """
    return replay_services(contents_of(path), read(path), [service])[service]


def why_silent(contents: Contents, service: str) -> str:
    """Return, for people, why a log holds nothing that a service said in a game."""
    return "no game of its own" if contents.has(f"health/{service}", service) else "not recorded with"
