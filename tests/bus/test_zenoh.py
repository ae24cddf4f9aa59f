"""What only processes can show: stops, kills, strangers, exits, and that nothing listens beyond the private folder."""

from __future__ import annotations

import itertools
import os
import random
import signal
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
import zenoh
from bus_network import PATIENCE, Zenoh
from bus_tables import CALLS, TOPICS, pose, question

from schemas import TOPICS as SCHEMA_TOPICS
from schemas import ColorImage, Intrinsics, MalformedMessage
from vantage.bus import Alive, Bus, CannotOpen, Event, Reply, Request, Sample
from vantage.bus.zenoh_bus import ZenohBus
from vantage.bus.zenoh_session import LEASE, connections

AT_ONCE = 0.8 * LEASE
"""Seconds: what takes less did not wait until Zenoh gave a silent peer up. benchmarks/start_up.py measures what it takes."""


def publish_at(bus: Bus, key: str, count: int, rate: float, start: int = 0) -> float:
    """Publish `count` poses at `rate` a second; return the longest time one took, s."""
    longest = 0.0
    begin = time.perf_counter()
    for number in range(count):
        before = time.perf_counter()
        bus.publish(key, pose(start + number))
        longest = max(longest, time.perf_counter() - before)
        time.sleep(max(0.0, begin + (number + 1) / rate - time.perf_counter()))
    return longest


def collect_samples(network: Zenoh, bus: Bus, count: int, uncounted: set[str]) -> list[Sample]:
    def done(events: list[Event]) -> bool:
        return sum(isinstance(event, Sample) and event.key not in uncounted for event in events) == count

    return [event for event in network.collect(bus, done) if isinstance(event, Sample)]


def picture(stamp: int) -> ColorImage:
    intrinsics = Intrinsics(fx=1.0, fy=1.0, cx=0.0, cy=0.0)
    return ColorImage(stamp=stamp, width=128, height=130, intrinsics=intrinsics, data=bytes(3 * 128 * 130))


def test_stopped_reader_loses_nothing_and_holds_nobody_up(zenoh_network: Zenoh) -> None:
    publisher = zenoh_network.session("publisher")
    listener = zenoh_network.participant("recorder", "listen", "steady", "picture")
    zenoh_network.wait_for_reader(publisher, "steady")
    zenoh_network.wait_for_reader(publisher, "picture")
    publisher.publish("steady", pose(0))
    publisher.publish("picture", picture(0))
    listener.wait_for("sample")
    listener.wait_for("sample")
    listener.signal(signal.SIGSTOP)
    longest = 0.0
    for number in range(1, 301):
        before = time.perf_counter()
        publisher.publish("picture", picture(number))
        longest = max(longest, time.perf_counter() - before)
        longest = max(longest, publish_at(publisher, "steady", 10, 1000.0, 10 * number))
    listener.signal(signal.SIGCONT)
    while sum(line[0] != "ready" for line in listener.lines) < 3302:
        listener.line()
    said = listener.lines[1:]
    assert [line for line in said if line[0] != "sample"] == []
    assert [line[3] for line in said if line[1] == "picture"] == list(range(301))
    assert [line[3] for line in said if line[1] == "steady"] == list(range(3001))
    assert longest < AT_ONCE / 2  # a publisher that waits for a reader waits 5 s


def test_too_small_a_cache_loses_and_says_exactly_how_many(zenoh_network: Zenoh) -> None:
    publisher = zenoh_network.session("publisher")
    listener = zenoh_network.participant("recorder", "listen", "tiny")
    zenoh_network.wait_for_reader(publisher, "tiny")
    publisher.publish("tiny", pose(0))
    listener.wait_for("sample")
    listener.signal(signal.SIGSTOP)
    # Beyond the lease, and so much that the sockets between cannot hold it.
    for start in range(1, 20001, 2000):
        publish_at(publisher, "tiny", 2000, 8000.0, start)
    listener.signal(signal.SIGCONT)
    while listener.lines[-1][0] != "sample" or listener.lines[-1][3] != 20000:
        listener.line()
    received = [line[3] for line in listener.lines if line[0] == "sample"]
    lost = sum(int(str(line[3])) for line in listener.lines if line[0] == "lost")
    assert received == sorted(set(received), key=lambda number: int(str(number)))
    assert received[-16:] == list(range(19985, 20001))
    assert lost == 20001 - len(received) > 0


def test_killed_and_restarted_reader_is_back_at_once_with_the_latched_messages(zenoh_network: Zenoh) -> None:
    zenoh_network.participant("publisher", "latch", "steady", "hider/pose")
    zenoh_network.participant("second", "latch", "seeker/pose")
    watcher = zenoh_network.session("watcher")
    watcher.watch()
    reader = zenoh_network.participant("reader", "listen", "steady", "*/pose")
    for _ in range(2):
        zenoh_network.collect(watcher, lambda events: Alive("reader", True) in events)
        reader.kill()
        before = time.monotonic()
        zenoh_network.collect(watcher, lambda events: Alive("reader", False) in events)
        assert time.monotonic() - before < AT_ONCE
        reader = zenoh_network.participant("reader", "listen", "steady", "*/pose")
        before = time.monotonic()
        for _ in range(3):
            reader.line()
        assert time.monotonic() - before < AT_ONCE
        assert sorted(reader.lines[1:], key=str) == [
            ["sample", "hider/pose", "publisher", 2, 3],
            ["sample", "seeker/pose", "second", 2, 3],
            ["sample", "steady", "publisher", 2, 3],
        ]


def test_killed_hub_is_missed_by_nobody(zenoh_network: Zenoh) -> None:
    hub = zenoh_network.participant("recorder", "listen", "**")
    publisher, reader = zenoh_network.session("publisher"), zenoh_network.session("reader")
    reader.subscribe("steady")
    zenoh_network.wait_for_reader(publisher, "steady")
    publish_at(publisher, "steady", 100, 2000.0)
    hub.kill()
    publish_at(publisher, "steady", 100, 2000.0, 100)
    events = zenoh_network.take(reader, 200)
    assert [event.decode().stamp for event in events if isinstance(event, Sample)] == list(range(200))
    hub = zenoh_network.participant("recorder", "listen", "steady")
    assert hub.line() == ["sample", "steady", "publisher", 199, 199]
    publisher.publish("steady", pose(200))
    assert hub.line() == ["sample", "steady", "publisher", 200, 200]


def test_killed_publisher_restarts_without_a_gap(zenoh_network: Zenoh) -> None:
    reader = zenoh_network.session("reader")
    reader.subscribe("steady")
    for _ in range(2):
        publisher = zenoh_network.participant("publisher", "count", "steady")
        seen: list[Event] = zenoh_network.take(reader, 100)
        publisher.kill()
        seen += zenoh_network.rest(reader)
        assert all(isinstance(event, Sample) for event in seen)
        sequences = [event.sequence for event in seen if isinstance(event, Sample)]
        assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))


def test_killed_server_ends_the_call_at_once(zenoh_network: Zenoh) -> None:
    caller = zenoh_network.session("caller")
    server = zenoh_network.participant("server", "hold")
    caller.watch()
    zenoh_network.collect(caller, lambda events: Alive("server", True) in events)
    tokens = {caller.call("question", question(seed), 30.0) for seed in range(20)}
    for _ in tokens:
        server.wait_for("asked")
    server.kill()
    before = time.monotonic()
    events = zenoh_network.collect(caller, lambda events: sum(isinstance(event, Reply) for event in events) == 20)
    assert time.monotonic() - before < AT_ONCE
    assert {event.token for event in events if isinstance(event, Reply) and event.error} == tokens
    assert Alive("server", False) in events + zenoh_network.rest(caller)


def test_stopped_server_is_timed_out(zenoh_network: Zenoh) -> None:
    caller = zenoh_network.session("caller")
    server = zenoh_network.participant("server", "hold")
    caller.watch()
    zenoh_network.collect(caller, lambda events: Alive("server", True) in events)
    server.signal(signal.SIGSTOP)
    before = time.monotonic()
    caller.call("question", question(1), 0.5)
    zenoh_network.collect(caller, lambda events: any(isinstance(event, Reply) and bool(event.error) for event in events))
    assert 0.4 < time.monotonic() - before < AT_ONCE


def test_stopped_process_shows_and_then_holds_up_nobody_that_leaves(zenoh_network: Zenoh) -> None:
    watcher = zenoh_network.session("watcher")
    server = zenoh_network.participant("server", "hold")
    watcher.watch()
    zenoh_network.collect(watcher, lambda events: Alive("server", True) in events)
    server.signal(signal.SIGSTOP)
    zenoh_network.collect(watcher, lambda events: Alive("server", False) in events)
    before = time.monotonic()
    watcher.close()
    assert time.monotonic() - before < AT_ONCE
    # Nor anybody that comes and greets it in vain.
    for role in ("forget", "fail"):
        leaver = zenoh_network.participant("second", role)
        before = time.monotonic()
        leaver.process.communicate(timeout=PATIENCE)
        assert time.monotonic() - before < AT_ONCE
        assert leaver.process.returncode == (0 if role == "forget" else 1)
    server.signal(signal.SIGCONT)


def test_late_joiner_is_not_held_up_by_a_stopped_publisher(zenoh_network: Zenoh) -> None:
    stopped = zenoh_network.participant("second", "latch", "seeker/pose")
    zenoh_network.participant("publisher", "latch", "hider/pose")
    stopped.signal(signal.SIGSTOP)
    reader = zenoh_network.session("reader")
    before = time.monotonic()
    reader.subscribe("*/pose")
    (event,) = zenoh_network.take(reader, 1)
    assert isinstance(event, Sample)
    assert event.key == "hider/pose"
    assert time.monotonic() - before < AT_ONCE
    stopped.signal(signal.SIGCONT)


def test_garbage_harms_nothing(zenoh_network: Zenoh) -> None:
    publisher, reader = zenoh_network.session("publisher"), zenoh_network.session("reader")
    recorder, server = zenoh_network.session("recorder"), zenoh_network.session("server")
    reader.subscribe("**")
    recorder.subscribe("**", raw=True)
    server.serve("question")
    stranger = zenoh_network.stranger()
    for bus in (publisher, reader, recorder, server):
        bus.receive(0.0)
    zenoh_network.wait_for_names(stranger, {"publisher", "reader", "recorder", "server"})
    chance = random.Random(1)
    keys = [f"vantage/table/{key}" for key in (*TOPICS, "undeclared/key")]
    for _ in range(50):
        for key in keys:
            attachment = chance.choice([None, chance.randbytes(chance.randrange(200)), bytes(15), b"\xff" * 17])
            data = chance.randbytes(chance.randrange(100))
            stranger.put(key, data, attachment=attachment, congestion_control=zenoh.CongestionControl.BLOCK)
    replies = [
        stranger.get("vantage/table/question", payload=payload, timeout=PATIENCE) for payload in (None, chance.randbytes(50))
    ]
    for reply in replies:
        (request,) = zenoh_network.take(server, 1)
        assert isinstance(request, Request)
        with pytest.raises(MalformedMessage):
            request.decode()
        request.fail("malformed")
        assert next(iter(reply)).err is not None
    publisher.publish("steady", pose(1))
    for bus, expected in ((reader, 50 * (len(keys) - 2) + 1), (recorder, 50 * len(keys) + 1)):
        # Of the `latest` topic the reader sees what it happens to see.
        received = collect_samples(zenoh_network, bus, expected, {"newest"} if bus is reader else set())
        (good,) = [event for event in received if event.publisher]
        assert (good.publisher, good.decode()) == ("publisher", pose(1))
        for event in received:
            if event is not good:
                with pytest.raises(MalformedMessage):
                    event.decode()


@pytest.mark.parametrize("role", ["forget", "fail"])
def test_process_that_forgets_to_close_ends_at_once(zenoh_network: Zenoh, role: str) -> None:
    zenoh_network.participant("server", "hold")
    leaver = zenoh_network.participant("publisher", role)
    before = time.monotonic()
    leaver.process.communicate(timeout=PATIENCE)
    assert time.monotonic() - before < AT_ONCE
    assert leaver.process.returncode == (0 if role == "forget" else 1)


def test_process_leaves_at_once_although_others_are_stopped(zenoh_network: Zenoh) -> None:
    stopped = zenoh_network.participant("recorder", "listen", "**")
    leaver = zenoh_network.session("publisher")
    zenoh_network.wait_for_reader(leaver, "picture")
    stopped.signal(signal.SIGSTOP)
    for number in range(200):
        leaver.publish("picture", picture(number))
    before = time.monotonic()
    leaver.close()
    assert time.monotonic() - before < AT_ONCE
    stopped.signal(signal.SIGCONT)


def test_nothing_listens_outside_the_folder(zenoh_network: Zenoh) -> None:
    listener = zenoh_network.participant("recorder", "listen", "**")
    process = psutil.Process(listener.process.pid)
    assert process.net_connections("inet") == []
    sockets = {connection.laddr for connection in process.net_connections("unix") if connection.laddr}
    assert sockets == {str(zenoh_network.folder / "recorder.sock")}
    assert zenoh_network.folder.stat().st_mode & 0o777 == 0o700


def test_of_each_two_exactly_one_connects_to_the_other(place: Path) -> None:
    known = frozenset(name for topic in SCHEMA_TOPICS.values() for name in topic.publishers)
    endpoints = {name: set(connections(name, place, known)) for name in (*known, "watch-1")}
    for one, other in itertools.combinations(endpoints, 2):
        assert (one in endpoints[other]) != (other in endpoints[one])


def test_stale_socket_of_a_killed_process_takes_no_name(zenoh_network: Zenoh) -> None:
    zenoh_network.participant("reader", "listen", "**").kill()
    assert (zenoh_network.folder / "reader.sock").is_socket()
    reader = zenoh_network.session("reader")
    reader.subscribe("steady")
    publisher = zenoh_network.session("publisher")
    publisher.publish("steady", pose(1))
    zenoh_network.take(reader, 1)


@pytest.fixture
def place() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="v", dir="/tmp") as name:
        yield Path(name)


def refusal(folder: Path) -> str:
    with pytest.raises(CannotOpen) as caught:
        ZenohBus("publisher", folder, topics=TOPICS, calls=CALLS)
    return str(caught.value)


def test_folder_must_be_private_short_and_a_folder(place: Path) -> None:
    open_to_others = place / "open"
    open_to_others.mkdir()
    open_to_others.chmod(0o755)
    assert f"chmod 700 {open_to_others}" in refusal(open_to_others)
    assert "too long for a socket" in refusal(place / ("x" * 90))
    (place / "link").symlink_to(place)
    assert "not a folder" in refusal(place / "link")
    (place / "file").touch()
    assert "file" in refusal(place / "file")
    assert "must not have" in refusal(place / "a#b")
    with ZenohBus("publisher", place / "fresh" / "deep", topics=TOPICS):
        assert (place / "fresh" / "deep").stat().st_mode & 0o777 == 0o700


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make a folder of somebody else")
def test_folder_must_be_ones_own(place: Path) -> None:
    foreign = place / "foreign"
    foreign.mkdir(mode=0o700)
    os.chown(foreign, 65534, 65534)
    assert "belongs to user 65534" in refusal(foreign)


def test_longest_path_that_fits_works(place: Path) -> None:
    folder = place / ("x" * (107 - len(f"{place}//publisher.sock")))
    with ZenohBus("publisher", folder, topics=TOPICS):
        assert (folder / "publisher.sock").is_socket()
    assert "too long" in refusal(Path(f"{folder}x"))
