"""Listening to a running table for some seconds: who is there, at what rate, how old what arrives is.

Ages are told without comparing clocks: a participant's clock is known from what it published and when that arrived; stamps are of
its clock, too.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from schemas import ROBOTS, TOPICS, ColorImage, DepthImage, Health, Layout, MalformedMessage, Message, Track
from vantage.bus import Bus, Sample
from vantage.cores import available_cores
from vantage.deployment import Process
from vantage.printable import counted
from vantage.service import TOO_SLOW
from vantage.setting_up.verdict import Verdict
from vantage.watch import Verdict as ServiceVerdict
from vantage.watch import judge

Picture = npt.NDArray[np.uint8]

LISTENED = (
    *("health/*", "layout", "overhead/color"),
    *(f"{robot}/{part}" for robot in ROBOTS for part in ("track", "camera/color", "camera/depth", "color", "depth")),
)
LOWEST_SHARE = 0.5
"""Of a topic's expected rate."""
GREATEST_LATENCY = 0.1
"""s from a capture to its track's arrival, median; robots drive by it."""
GREATEST_DELAY = 0.25
"""s by which this command may be woken late; services are then, too, and robots are driven by them."""
GREATEST_LOAD = 2.0
"""Processes that want a core, for each that there is."""
LOWEST_SEEN = 0.9
"""Share of a robot's tracks in which its tag was seen, not predicted."""
_SILENT_TRACK = "is the tracker well, and the robot on the table with its tag in the overhead camera's sight?"
_WELL = {"robot": "ok, its robots answer", "tracker": "ok, its cameras give frames"}
_LOSE_FIRST = 0.3
"""s at the beginning that do not count for rates: subscriptions come into force."""


@dataclass
class Stream:
    """What came of one topic: arrivals, s; own clock less the stamp on arrival, ns; its publisher and its last message."""

    arrivals: list[float] = field(default_factory=list)
    behind: list[int] = field(default_factory=list)
    publisher: str = ""
    last: Message | None = None


@dataclass
class Heard:
    """What was heard.

    Attributes:
        seconds: for how long.
        streams: by topic.
        ended: ns, own clock.
        clocks: own clock less that of each participant, ns.
        health: last health of each service, and when it came, s after the beginning on the listener's own clock.
        seen: for each robot, whether each track was seen (True) or predicted.
        late: s by which this command was woken late, at worst.
        load: processes that wanted a core; cores: that there are.
    """

    seconds: float = 0.0
    streams: dict[str, Stream] = field(default_factory=dict)
    ended: int = 0
    clocks: dict[str, int] = field(default_factory=dict)
    health: dict[str, tuple[Health, float]] = field(default_factory=dict)
    seen: dict[str, list[bool]] = field(default_factory=lambda: {robot: [] for robot in ROBOTS})
    late: float = 0.0
    load: float = 0.0
    cores: int = 1

    def age(self, message: Message, publisher: str) -> float:
        """Return the age of a message at the end, s."""
        return max(0.0, (self.ended - message.stamp - self.clocks.get(publisher, 0)) / 1e9)

    def ages(self, stream: Stream) -> list[float]:
        """Return how old the messages of a topic were on arrival, s."""
        return [max(0.0, (behind - self.clocks.get(stream.publisher, 0)) / 1e9) for behind in stream.behind]

    def last_picture(self, key: str) -> Picture | None:
        """Return the last picture of a topic, uint8 [H, W, 3] RGB; None where none came but the one of before, which is kept."""
        stream = self.streams.get(key)
        if stream is None or not stream.arrivals or not isinstance(stream.last, ColorImage):
            return None
        image = stream.last
        return np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, 3)

    def robot_pictures(self, robot: str, *, raw: bool) -> tuple[Picture, npt.NDArray[np.uint16], float] | None:
        """Return a robot's last colour and depth, raw from its camera or as published at a step, with their age in s.

        uint8 [H, W, 3] RGB and uint16 [H, W]. None where there are none; of raw ones those kept from before do not count.
        """
        prefix = f"{robot}/camera" if raw else robot
        color, depth = (self.streams.get(f"{prefix}/{part}", Stream()) for part in ("color", "depth"))
        if not (isinstance(color.last, ColorImage) and isinstance(depth.last, DepthImage)):
            return None
        if raw and not (color.arrivals and depth.arrivals):
            return None
        shown = np.frombuffer(color.last.data, np.uint8).reshape(color.last.height, color.last.width, 3)
        far = np.frombuffer(depth.last.data, "<u2").reshape(depth.last.height, depth.last.width)
        return shown, far.astype(np.uint16), self.age(color.last, color.publisher)


def listen(bus: Bus, seconds: float, tell: Callable[[float], None], clock: Callable[[], int] = time.monotonic_ns) -> Heard:
    """Take in what is said on a bus.

    Args:
        tell: called with the seconds that have passed.
        clock: ns.
    """
    bus.subscribe(*LISTENED)
    heard = Heard()
    began = time.monotonic()
    while (passed := time.monotonic() - began) < seconds + _LOSE_FIRST:
        tell(passed)
        wait = min(0.1, seconds + _LOSE_FIRST - passed)
        event = bus.receive(wait)
        heard.late = max(heard.late, time.monotonic() - began - passed - wait)
        if isinstance(event, Sample):
            take(heard, event, passed, clock())
    heard.seconds, heard.ended = seconds, clock()
    heard.load, heard.cores = os.getloadavg()[0], available_cores()
    return heard


def take(heard: Heard, sample: Sample, passed: float, now: int) -> None:
    """Take in a sample that came `passed` s after the beginning at `now` ns; strangers and malformed messages are passed over."""
    topic = TOPICS.get(sample.key)
    if topic is None or sample.publisher not in topic.publishers:
        return
    try:
        message = sample.decode()
    except MalformedMessage:
        return
    offset = now - sample.sent
    heard.clocks[sample.publisher] = min(heard.clocks.get(sample.publisher, offset), offset)
    if isinstance(message, Health):
        heard.health[message.service] = message, passed
    stream = heard.streams.setdefault(sample.key, Stream())
    stream.last, stream.publisher = message, sample.publisher
    if passed >= _LOSE_FIRST:
        stream.arrivals.append(passed)
        stream.behind.append(now - message.stamp)
        if isinstance(message, Track):
            heard.seen[sample.key.partition("/")[0]].append(message.seen)


def judge_heard(heard: Heard, deployment: str, processes: list[Process], obstacles: int | None) -> list[Verdict]:
    """Judge a running table.

    Args:
        deployment: its name.
        processes: of the deployment.
        obstacles: boxes that the table ought to have; None: unknown.
    """
    verdicts = [_machine(heard)]
    for process in processes:
        health, arrived = heard.health.get(process.name, (None, 0.0))
        verdicts.append(_service(judge(process, health, heard.seconds + _LOSE_FIRST - arrived), deployment))
    verdicts += [_rate(heard, key) for key in sorted(heard.streams) if _is_stream(key)]
    for robot in ROBOTS:
        verdicts += _track(heard, robot)
    layout = heard.streams.get("layout", Stream()).last
    if isinstance(layout, Layout) and obstacles is not None:
        found = len(layout.obstacles)
        remedy = f"the table's file has {obstacles}: are all tags in the overhead camera's sight?" if found != obstacles else ""
        verdicts.append(Verdict("layout", f"{found} box{'es' * (found != 1)}", remedy))
    return verdicts


def _machine(heard: Heard) -> Verdict:
    """Judge whether the machine keeps up: on one that does not, robots and cameras look as if they were broken."""
    cores = counted(heard.cores, "core")
    figures = f"load {heard.load:.1f} on {cores}, this command woken {1000 * heard.late:.0f} ms late"
    slow = sorted(name for name, (health, _) in heard.health.items() if TOO_SLOW in health.reason)
    if slow:
        figures += f", too slow for {', '.join(slow)}"
    busy = bool(slow) or heard.late > GREATEST_DELAY or heard.load > GREATEST_LOAD * heard.cores
    return Verdict(
        "machine", figures, "this machine is too slow: stop other programs, or take one with more cores" if busy else ""
    )


def _service(verdict: ServiceVerdict, deployment: str) -> Verdict:
    name = verdict.process.name
    if verdict.healthy:
        return Verdict(f"service {name}", _WELL.get(name, verdict.state))
    remedy = f'see docs/table.md, "What goes wrong", and `vantage logs {name} --deployment {deployment}`'
    return Verdict(f"service {name}", verdict.trouble, remedy)


def _is_stream(key: str) -> bool:
    return key in TOPICS and TOPICS[key].delivery == "latest"


def _rate(heard: Heard, key: str) -> Verdict:
    stream = heard.streams[key]
    # Where the raw frames of the camera above are on the bus, there are as many tracks as frames.
    source = "overhead/color" if key.endswith("/track") and "overhead/color" in heard.streams else key
    expected = TOPICS[source].rate
    rate = len(stream.arrivals) / heard.seconds if heard.seconds else 0.0
    if not stream.arrivals:
        return Verdict(key, "nothing heard", _SILENT_TRACK if key.endswith("/track") else "is the camera plugged in?")
    slow = "camera, cable or computer is too slow: set the camera's rate and a short exposure, stop other programs"
    return Verdict(key, f"{rate:.1f} a second, expected {expected:g}", slow if rate < LOWEST_SHARE * expected else "")


def _track(heard: Heard, robot: str) -> list[Verdict]:
    stream = heard.streams.get(f"{robot}/track")
    if stream is None:
        return [Verdict(f"{robot}/track", "nothing heard", _SILENT_TRACK)]
    ages = heard.ages(stream)
    if not ages:
        return []  # its rate says so
    middle, late = (1000.0 * float(np.percentile(ages, share)) for share in (50, 95))
    share = float(np.mean(heard.seen[robot]))
    return [
        Verdict(
            f"{robot} latency",
            f"{middle:.0f} ms from capture to here (median; 95 % within {late:.0f} ms)",
            "" if middle <= 1000.0 * GREATEST_LATENCY else "robots steer by this: lower resolution or rate, stop other programs",
        ),
        Verdict(
            f"{robot} tag",
            f"seen in {100.0 * share:.0f} % of its tracks",
            "" if share >= LOWEST_SEEN else "light, focus or glare: run `vantage table check --source` on a picture of the table",
        ),
    ]
