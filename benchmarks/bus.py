"""The bus against raw Zenoh with the same settings, in one run and by turns; and the in-process bus.

    python benchmarks/bus.py

One way, between two processes: from before `publish` to after `receive` and `decode`; raw, from before `put` until the payload's
bytes are out of a queue. Raw Zenoh uses the same session configuration, publisher options and kind of callback, and like the
bus it is given a new message each time (its bytes are ready before the clock starts; ours are encoded while it runs).
"""

from __future__ import annotations

import json
import multiprocessing
import queue
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TypeVar

import tyro
import zenoh
from zenoh import ext
from zenoh.handlers import Callback

from schemas import TOPICS, ColorImage, Intrinsics, Message, Pose, Topic, encode
from vantage.bus import InProcessNetwork, Lost, Sample
from vantage.bus.zenoh_bus import HEARTBEAT, ZenohBus, encoding_of
from vantage.bus.zenoh_session import configuration

AnyItem = TypeVar("AnyItem")
Way = tuple[Callable[..., None], list[float]]

INTRINSICS = Intrinsics(fx=100.0, fy=100.0, cx=64.0, cy=65.0)


def image(width: int, height: int) -> ColorImage:
    data = bytes(bytearray(width * height) * 3)
    return ColorImage(stamp=time.time_ns(), width=width, height=height, intrinsics=INTRINSICS, data=data)


def pose() -> Pose:
    return Pose(stamp=time.time_ns(), x=0.1234, y=0.5678, heading=0.5)


SIZES: dict[str, tuple[str, Callable[[], Message]]] = {
    "100 B": ("hider/pose", pose),
    "50 KB": ("hider/color", lambda: image(128, 130)),
    "1 MB": ("seeker/color", lambda: image(640, 546)),
}


BURST = "burst"
TABLE = {**TOPICS, BURST: Topic(BURST, Pose, ("simulator",), cache=100_000)}


@dataclass
class Settings:
    rounds: int = 400
    """Messages of each size and kind, by turns."""
    pause: float = 0.0
    """Seconds between messages."""
    burst: int = 20_000
    """Small messages for the throughput."""


def raw_session(name: str, folder: Path) -> zenoh.Session:
    known = frozenset({"raw-reader", "raw-writer"})
    return zenoh.open(zenoh.Config.from_json5(json.dumps(configuration(name, folder, known))))


def raw_publisher(session: zenoh.Session, key: str) -> ext.AdvancedPublisher:
    topic = TABLE[key]
    return ext.declare_advanced_publisher(
        session,
        f"raw/{key}",
        encoding=encoding_of(topic.type),
        congestion_control=zenoh.CongestionControl.DROP,
        cache=ext.CacheConfig(topic.cache),
        sample_miss_detection=ext.MissDetectionConfig(heartbeat=HEARTBEAT, sporadic_heartbeat=None),
        publisher_detection=True,
    )


def by_turns(number: int, first: AnyItem, second: AnyItem) -> tuple[AnyItem, AnyItem]:
    """Return the two, in the other order every second time: who comes second finds the caches warm."""
    return (second, first) if number % 2 else (first, second)


def read(folder: Path, pipe: Connection, settings: Settings) -> None:
    """The other process: take each message, note the time, say so."""
    bus = ZenohBus("console", folder, topics=TABLE)
    keys = [*(key for key, _ in SIZES.values()), BURST]
    bus.subscribe(*keys)
    raw = raw_session("raw-reader", folder)
    arrived: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
    subscribers = [raw.declare_subscriber(f"raw/{key}", Callback(arrived.put, indirect=False)) for key in keys]

    def from_bus() -> int:
        while True:
            event = bus.receive(10.0)
            assert event is not None, "a message is missing"
            if isinstance(event, Sample):
                event.decode()
                return 1
            if isinstance(event, Lost):
                return event.missed

    def from_raw() -> int:
        arrived.get(timeout=10.0).payload.to_bytes()
        return 1

    pipe.send("ready")
    for _ in SIZES:
        for number in range(settings.rounds):
            for take in by_turns(number, from_bus, from_raw):
                take()
                pipe.send(time.monotonic_ns())
    delivered = passed = 0
    while passed < settings.burst:
        step = from_bus()
        passed += step
        delivered += step == 1
    pipe.send((delivered, time.monotonic_ns()))
    count, last = 0, 0
    try:
        while True:
            arrived.get(timeout=2.0).payload.to_bytes()
            count, last = count + 1, time.monotonic_ns()
    except queue.Empty:
        pipe.send((count, last))
    pipe.recv()
    del subscribers
    raw.close()
    bus.close()


def percentile(values: list[float], part: float) -> float:
    return sorted(values)[min(len(values) - 1, int(part * len(values)))]


def between_processes(settings: Settings) -> None:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    with tempfile.TemporaryDirectory(prefix="v", dir="/tmp") as name:
        folder = Path(name)
        reader = context.Process(target=read, args=(folder, theirs, settings))
        reader.start()
        ours.recv()
        with ZenohBus("simulator", folder, topics=TABLE) as bus, raw_session("raw-writer", folder) as raw:
            print(f"{'one way':10} {'bus p50':>10} {'p99':>10} {'raw p50':>10} {'p99':>10} {'p50 ratio':>10}")
            for size, (key, make) in SIZES.items():
                publisher = raw_publisher(raw, key)
                while not (bus.has_reader(key) and raw.declare_publisher(f"raw/{key}").matching_status.matching):  # type: ignore[attr-defined]
                    time.sleep(0.01)
                of_bus: list[float] = []
                of_raw: list[float] = []
                both: tuple[Way, Way] = (partial(bus.publish, key), of_bus), (publisher.put, of_raw)
                for number in range(settings.rounds):
                    for send, taken in by_turns(number, *both):
                        message = make() if taken is of_bus else encode(make())
                        if settings.pause:
                            time.sleep(settings.pause)
                        before = time.monotonic_ns()
                        send(message)
                        taken.append((ours.recv() - before) / 1e3)
                medians = statistics.median(of_bus), statistics.median(of_raw)
                print(
                    f"{size:10} {medians[0]:7.0f} us {percentile(of_bus, 0.99):7.0f} us "
                    f"{medians[1]:7.0f} us {percentile(of_raw, 0.99):7.0f} us {medians[0] / medians[1]:10.2f}"
                )
            message = pose()
            before = time.monotonic_ns()
            for _ in range(settings.burst):
                bus.publish(BURST, message)
            delivered, last = ours.recv()
            rate = delivered / (last - before) * 1e9
            publisher, payload = raw_publisher(raw, BURST), encode(message)
            before = time.monotonic_ns()
            for _ in range(settings.burst):
                publisher.put(payload)
            count, last = ours.recv()
            print(
                f"burst of {settings.burst} small messages: bus {rate:,.0f}/s, {settings.burst - delivered} lost and counted; ",
                end="",
            )
            print(f"raw {count / (last - before) * 1e9:,.0f}/s, {settings.burst - count} dropped")
        ours.send("done")
        reader.join(10)


def in_process() -> None:
    network = InProcessNetwork()
    publisher = network.session("simulator")
    readers = [network.session(name) for name in ("seeker", "planner", "referee", "recorder", "console")]
    for reader in readers:
        reader.subscribe("hider/pose")
    message = pose()
    best = float("inf")
    for _ in range(50):
        before = time.perf_counter()
        for _ in range(1000):
            publisher.publish("hider/pose", message)
            for reader in readers:
                event = reader.receive(0.0)
                assert isinstance(event, Sample)
                event.decode()
        best = min(best, (time.perf_counter() - before) / 1000 / len(readers))
    print(f"in-process, {len(readers)} readers: {best * 1e6:.2f} us a delivery (publish, receive, decode)")


if __name__ == "__main__":
    chosen = tyro.cli(Settings, description=__doc__)
    between_processes(chosen)
    in_process()
