"""Clocks that were set, and clocks of other machines, decide nothing about what is old and what is new."""

from __future__ import annotations

import time

import pytest
from bus_network import Zenoh
from bus_tables import CALLS, TOPICS, pose

from schemas import encode
from vantage.bus import Sample
from vantage.bus.clock import IDENTITY_SIZE, SteadyClock
from vantage.bus.zenoh_bus import ZenohBus


def stamps(events: list[object]) -> list[int]:
    return [event.decode().stamp for event in events if isinstance(event, Sample)]


@pytest.mark.parametrize("set_by", [-5.0, 5.0])
def test_a_reader_whose_clock_was_set_gets_no_wish_from_before(zenoh_network: Zenoh, set_by: float) -> None:
    publisher = zenoh_network.session("publisher")
    publisher.publish("wish", pose(1))
    publisher.publish("steady", pose(1))
    reader = zenoh_network.participant("reader", "listen", "wish", "steady", set_by=set_by)
    # The latched message shows that the cache has answered.
    assert reader.wait_for("sample")[1:] == ["steady", "publisher", 0, 1]
    zenoh_network.wait_for_reader(publisher, "wish")
    publisher.publish("wish", pose(2))
    assert reader.wait_for("sample")[1:] == ["wish", "publisher", 1, 2]
    assert [line for line in reader.lines if line[0] == "lost"] == []


@pytest.mark.parametrize("set_by", [-5.0, 5.0])
def test_a_publisher_whose_clock_was_set_is_heard_from_its_first_message(
    zenoh_network: Zenoh, monkeypatch: pytest.MonkeyPatch, set_by: float
) -> None:
    """Published before the two have met, it comes out of the cache."""
    reader = zenoh_network.session("reader")
    reader.subscribe("wish")
    publisher = zenoh_network.participant("publisher", "latch", "wish", set_by=set_by)
    assert stamps(zenoh_network.take(reader, 3)) == [1, 2, 3]
    publisher.kill()
    # The same with this process's clock, which steps while the session is open.
    true_time_ns = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: true_time_ns() + round(set_by * 1e9))
    second = zenoh_network.session("second")
    second.publish("wish", pose(4))
    assert stamps(zenoh_network.take(reader, 1)) == [4]


def test_times_of_publishing_are_of_one_clock_although_one_was_set(zenoh_network: Zenoh) -> None:
    """The order of a log by them holds, also of what was published by processes from before and after the step."""
    reader = zenoh_network.session("recorder")
    reader.subscribe("**", raw=True)
    times = []
    for name, set_by in (("publisher", 0.0), ("second", -3600.0)):
        before = time.time_ns()
        zenoh_network.participant(name, "latch", "steady", set_by=set_by)
        events = zenoh_network.take(reader, 3)
        times += [event.published for event in events if isinstance(event, Sample)]
        # The publisher's stamps are by its own clock, and so is `sent`.
        ahead = [event.sent - event.published for event in events if isinstance(event, Sample)]
        assert ahead == pytest.approx([set_by * 1e9] * 3, abs=1e9)
        assert before - 10**9 < times[-1] < time.time_ns() + 10**9
    assert times == sorted(times)


@pytest.mark.parametrize("ahead", [-3600, 3600])
def test_another_machines_clock_is_not_compared(zenoh_network: Zenoh, ahead: int) -> None:
    """What arrives live is new, what only the cache has is history."""
    other = SteadyClock(bytes(IDENTITY_SIZE), lambda: time.monotonic_ns() + ahead * 10**9)
    publisher = ZenohBus("publisher", zenoh_network.folder, topics=TOPICS, calls=CALLS, clock=other)
    zenoh_network.sessions.append(publisher)
    for stamp in range(3):
        publisher.publish("wish", pose(stamp))
        publisher.publish("deep", pose(stamp))
    reader = zenoh_network.session("reader")
    reader.subscribe("wish", "deep")
    assert stamps(zenoh_network.take(reader, 3)) == [0, 1, 2]
    zenoh_network.wait_for_reader(publisher, "wish")
    publisher.publish("wish", pose(3))
    assert stamps(zenoh_network.take(reader, 1)) == [3]
    assert zenoh_network.rest(reader) == []


def test_a_robot_that_tells_no_clock_is_heard(zenoh_network: Zenoh) -> None:
    """The attachment of docs/robot-protocol.md: numbers, start time, name."""
    reader = zenoh_network.session("reader")
    reader.subscribe("steady")
    stranger = zenoh_network.stranger()
    reader.receive(0.0)
    zenoh_network.wait_for_names(stranger, {"reader"})
    numbers = b"".join(number.to_bytes(8, "little") for number in (0, 77, 55))
    stranger.put("vantage/table/steady", encode(pose(9)), attachment=numbers + b"second")
    (sample,) = zenoh_network.take(reader, 1)
    assert isinstance(sample, Sample)
    assert (sample.publisher, sample.published, sample.decode()) == ("second", 77, pose(9))
