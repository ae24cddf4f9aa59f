"""What every bus promises, asked of each implementation."""

from __future__ import annotations

import gc
import threading

import pytest
from bus_network import Network
from bus_tables import pose, question

from schemas import Command, Layout, MalformedMessage, Pose, Tick
from vantage.bus import (
    Alive,
    Bus,
    CallFailed,
    CannotOpen,
    Event,
    Lost,
    NameInUse,
    NotPublisher,
    Reply,
    Request,
    Sample,
    UndeclaredKey,
    WrongType,
)


def samples(events: list[Event]) -> list[Sample]:
    return [event for event in events if isinstance(event, Sample)]


def stamps(events: list[Event]) -> list[int]:
    return [sample.decode().stamp for sample in samples(events)]


def one(network: Network, bus: Bus, kind: type) -> Event:
    return network.collect(bus, lambda events: bool(events) and isinstance(events[-1], kind))[-1]


def meet(network: Network, bus: Bus, *others: Bus) -> None:
    """Wait until a session knows others, and with them what they read and serve."""
    bus.watch()
    for other in others:
        other.receive(0.0)
    names = {other.name for other in others}
    network.collect(bus, lambda events: names <= {event.name for event in events if isinstance(event, Alive) and event.alive})


def test_message_and_what_travels_with_it(network: Network) -> None:
    publisher, reader = network.session("publisher"), network.session("reader")
    reader.subscribe("hider/pose")
    network.wait_for_reader(publisher, "hider/pose")
    publisher.publish("hider/pose", pose(7))
    publisher.publish("hider/pose", pose(8))
    first, second = samples(network.take(reader, 2))
    assert (first.key, first.publisher, first.sequence) == ("hider/pose", "publisher", 0)
    assert first.decode() == pose(7)
    assert second.sequence == 1
    assert second.published >= first.published > 0
    assert Sample(first.key, first.payload, "", 0, 0, Pose).decode() == pose(7)


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("hider/pose", {"hider/pose"}),
        ("*/pose", {"hider/pose", "seeker/pose"}),
        ("hider/**", {"hider/pose", "hider/extra/pose"}),
        ("**/pose", {"hider/pose", "seeker/pose", "hider/extra/pose"}),
        ("*", {"steady"}),
        ("**", {"hider/pose", "seeker/pose", "hider/extra/pose", "steady"}),
    ],
)
def test_key_expressions_select_topics(network: Network, expression: str, expected: set[str]) -> None:
    publisher, reader = network.session("publisher"), network.session("reader")
    reader.subscribe(expression)
    for key in ("hider/pose", "seeker/pose", "hider/extra/pose", "steady"):
        publisher.publish(key, pose(1))
    events = network.take(reader, len(expected))
    assert {sample.key for sample in samples(events)} == expected
    assert len(events) == len(expected)


def test_overlapping_subscriptions_deliver_once(network: Network) -> None:
    publisher, reader = network.session("publisher"), network.session("reader")
    reader.subscribe("hider/pose", "*/pose")
    reader.subscribe("**")
    publisher.publish("hider/pose", pose(1))
    assert stamps(network.rest(reader)) == [1]


@pytest.mark.parametrize("expression", ["", "/hider", "hider/", "a//b", "hi*/pose", "@/x", "a?b", "a#b"])
def test_what_is_no_key_expression_is_refused(network: Network, expression: str) -> None:
    with pytest.raises(ValueError, match="key expression"):
        network.session("reader").subscribe(expression)


def test_order_and_own_messages(network: Network) -> None:
    publisher, reader = network.session("publisher"), network.session("reader")
    reader.subscribe("**")
    publisher.subscribe("steady")
    network.wait_for_reader(publisher, "steady")
    for stamp in range(500):
        publisher.publish("steady", pose(stamp))
    for bus in (reader, publisher):
        events = network.take(bus, 500)
        assert stamps(events) == list(range(500))
        assert [sample.sequence for sample in samples(events)] == list(range(500))


def test_reader_that_does_not_receive_loses_nothing(network: Network) -> None:
    publisher, reader = network.session("publisher"), network.session("reader")
    reader.subscribe("steady")
    network.wait_for_reader(publisher, "steady")
    for stamp in range(5000):
        publisher.publish("steady", pose(stamp))
    assert stamps(network.take(reader, 5000)) == list(range(5000))
    assert network.rest(reader) == []


def test_latest_skips_to_the_newest(network: Network) -> None:
    publisher, reader, recorder = network.session("publisher"), network.session("reader"), network.session("recorder")
    reader.subscribe("newest", "steady")
    recorder.subscribe("**", raw=True)
    meet(network, publisher, reader, recorder)
    for stamp in range(100):
        publisher.publish("newest", pose(stamp))
    publisher.publish("steady", pose(100))
    # The recorder has it all, so the reader's session has as well.
    recorded = network.collect(recorder, lambda events: bool(events) and stamps(events[-1:]) == [100])
    assert stamps(recorded)[-2] == 99
    received = stamps(network.collect(reader, lambda events: 100 in stamps(events)))
    assert sorted(received) == received
    assert 99 in received
    assert len(received) < len(recorded)


def test_late_joiner_gets_the_latched_messages(network: Network) -> None:
    publisher = network.session("publisher")
    for stamp in range(40):
        for key in ("tiny", "deep", "wish", "newest"):
            publisher.publish(key, pose(stamp))
    reader = network.session("reader")
    reader.subscribe("tiny", "deep", "wish", "newest")
    events = network.rest(reader)
    assert not [event for event in events if isinstance(event, Lost)]
    received = {key: stamps([s for s in samples(events) if s.key == key]) for key in ("tiny", "deep", "wish", "newest")}
    assert received == {"tiny": [39], "deep": [37, 38, 39], "wish": [], "newest": [39]}
    for key in received:
        publisher.publish(key, pose(40))
    events = network.rest(reader)
    assert sorted(sample.key for sample in samples(events)) == sorted(received)
    assert stamps(events) == [40] * 4


def test_late_recorder_gets_all_that_the_caches_hold(network: Network) -> None:
    publisher = network.session("publisher")
    for stamp in range(40):
        publisher.publish("tiny", pose(stamp))
        publisher.publish("steady", pose(stamp))
    recorder = network.session("recorder")
    recorder.subscribe("**", raw=True)
    events = network.rest(recorder)
    assert stamps([s for s in samples(events) if s.key == "tiny"]) == list(range(24, 40))
    assert stamps([s for s in samples(events) if s.key == "steady"]) == list(range(40))
    assert not [event for event in events if isinstance(event, Lost)]


def test_latched_messages_go_with_their_publisher(network: Network) -> None:
    publisher = network.session("publisher")
    publisher.publish("steady", pose(1))
    publisher.close()
    reader = network.session("reader")
    reader.subscribe("steady")
    assert network.rest(reader) == []


def test_restarted_publisher_is_no_gap(network: Network) -> None:
    reader = network.session("reader")
    reader.subscribe("steady")
    for start in (0, 100):
        publisher = network.session("publisher")
        network.wait_for_reader(publisher, "steady")
        for stamp in range(start, start + 50):
            publisher.publish("steady", pose(stamp))
        events = network.take(reader, 50)
        assert stamps(events) == list(range(start, start + 50))
        assert [sample.sequence for sample in samples(events)] == list(range(50))
        publisher.close()
    assert network.rest(reader) == []


def test_malformed_message_is_raised_in_the_reader_only(network: Network) -> None:
    publisher, reader = network.session("publisher"), network.session("reader")
    reader.subscribe("steady")
    network.wait_for_reader(publisher, "steady")
    publisher.publish("steady", Pose(stamp=1, x=1e9, y=0.0, heading=0.0))
    publisher.publish("steady", pose(2))
    bad, good = samples(network.take(reader, 2))
    with pytest.raises(MalformedMessage, match="Pose"):
        bad.decode()
    assert good.decode() == pose(2)


def test_what_the_tables_do_not_allow_is_refused(network: Network) -> None:
    publisher, reader = network.session("publisher"), network.session("reader")
    reader.subscribe("**")
    with pytest.raises(UndeclaredKey, match=r"`nothing` is not in the table of topics"):
        publisher.publish("nothing", pose(1))
    with pytest.raises(WrongType, match="`steady` carries Pose, not Command"):
        publisher.publish("steady", Command(stamp=1, primitive="stay"))
    with pytest.raises(NotPublisher, match=r"'reader' may not publish `steady`.*publisher, second"):
        reader.publish("steady", pose(1))
    with pytest.raises(UndeclaredKey, match="names no topic"):
        reader.subscribe("nothing/*")
    with pytest.raises(UndeclaredKey, match="table of calls"):
        reader.call("steady", question(1), 1.0)
    with pytest.raises(WrongType, match="`question` is asked with Control, not Layout"):
        reader.call("question", Layout(stamp=1), 1.0)
    with pytest.raises(NotPublisher, match="may not serve `question`: its server is server"):
        reader.serve("question")
    with pytest.raises(UndeclaredKey):
        reader.serve("nothing")
    assert network.rest(reader) == []


def test_call_is_answered(network: Network) -> None:
    server, caller = network.session("server"), network.session("caller")
    server.serve("question")
    token = ask_when_served(network, caller, server)
    request = one(network, server, Request)
    assert isinstance(request, Request)
    assert request.caller == "caller"
    assert request.decode() == question(5)
    with pytest.raises(WrongType, match="answered by Tick, not Pose"):
        request.reply(pose(1))
    request.reply(Tick(stamp=6))
    request.reply(Tick(stamp=7))
    request.fail("too late")
    (reply,) = [event for event in network.rest(caller) if isinstance(event, Reply)]
    assert (reply.token, reply.error, reply.decode()) == (token, "", Tick(stamp=6))


def ask_when_served(network: Network, caller: Bus, server: Bus) -> int:
    """Return the token of a call made as soon as the server is known to live."""
    meet(network, caller, server)
    return caller.call("question", question(5), 30.0)


def test_call_without_server_fails_at_once(network: Network) -> None:
    caller = network.session("caller")
    token = caller.call("question", question(1), 30.0)
    (reply,) = network.take(caller, 1)
    assert isinstance(reply, Reply)
    assert reply.token == token
    assert "question" in reply.error
    with pytest.raises(CallFailed, match="server"):
        reply.decode()


def test_call_times_out_and_ends_once(network: Network) -> None:
    server, caller = network.session("server"), network.session("caller")
    server.serve("question")
    ask_when_served(network, caller, server)
    first = one(network, server, Request)
    assert isinstance(first, Request)
    first.reply(Tick(stamp=1))
    one(network, caller, Reply)
    token = caller.call("question", question(2), 0.3)
    late = one(network, server, Request)
    network.pass_time(0.4)
    reply = one(network, caller, Reply)
    assert isinstance(reply, Reply)
    assert reply.token == token
    assert "within 0.3 s" in reply.error
    assert isinstance(late, Request)
    late.reply(Tick(stamp=2))
    assert network.rest(caller) == []


def test_server_that_leaves_ends_the_call(network: Network) -> None:
    server, caller = network.session("server"), network.session("caller")
    server.serve("question")
    ask_when_served(network, caller, server)
    request = one(network, server, Request)
    server.close()
    reply = one(network, caller, Reply)
    assert isinstance(reply, Reply)
    assert reply.payload is None
    assert "server" in reply.error
    assert isinstance(request, Request)
    request.reply(Tick(stamp=1))


def test_server_refuses_or_drops_a_request(network: Network) -> None:
    server, caller = network.session("server"), network.session("caller")
    server.serve("question")
    ask_when_served(network, caller, server)
    request = one(network, server, Request)
    assert isinstance(request, Request)
    request.fail("not today")
    reply = one(network, caller, Reply)
    assert isinstance(reply, Reply)
    assert reply.error == "not today"
    del request
    caller.call("question", question(1), 30.0)
    one(network, server, Request)
    gc.collect()
    reply = one(network, caller, Reply)
    assert isinstance(reply, Reply)
    assert "dropped" in reply.error


def test_malformed_request_reaches_the_server_as_such(network: Network) -> None:
    server, caller = network.session("server"), network.session("caller")
    server.serve("question")
    ask_when_served(network, caller, server)
    one(network, server, Request)
    gc.collect()
    caller.call("question", question(-1), 30.0)
    request = one(network, server, Request)
    assert isinstance(request, Request)
    with pytest.raises(MalformedMessage):
        request.decode()
    request.fail("malformed")
    replies = network.collect(caller, lambda events: any(isinstance(e, Reply) and e.error == "malformed" for e in events))
    assert len([event for event in replies if isinstance(event, Reply)]) <= 2


def test_many_calls_at_once_answered_in_batches(network: Network) -> None:
    server = network.session("server")
    callers = [network.session(name) for name in ("caller", "other")]
    server.serve("question")
    for caller in callers:
        meet(network, caller, server)
    tokens = [{caller.call("question", question(seed), 30.0): seed for seed in range(128)} for caller in callers]
    for _ in range(8):
        batch = network.collect(server, lambda events: sum(isinstance(e, Request) for e in events) >= 32)
        for request in reversed(batch):
            if isinstance(request, Request):
                request.reply(Tick(stamp=request.decode().stamp + 1000))
    for caller, asked in zip(callers, tokens, strict=True):
        events = network.collect(caller, lambda events: sum(isinstance(e, Reply) for e in events) >= 128)
        answers = {event.token: event.decode().stamp for event in events if isinstance(event, Reply)}
        assert answers == {token: seed + 1000 for token, seed in asked.items()}


def test_liveliness(network: Network) -> None:
    early, watcher = network.session("early"), network.session("watcher")
    early.receive(0.0)
    watcher.watch()
    assert set(network.take(watcher, 2)) == {Alive("early", True), Alive("watcher", True)}
    late = network.session("late")
    late.receive(0.0)
    assert network.take(watcher, 1) == [Alive("late", True)]
    late.close()
    early.close()
    assert network.take(watcher, 2) == [Alive("late", False), Alive("early", False)]
    assert network.rest(watcher) == []


def test_a_name_is_taken_while_its_session_is_open(network: Network) -> None:
    first = network.session("publisher")
    with pytest.raises(NameInUse, match="'publisher' is on the bus"):
        network.session("publisher")
    first.close()
    network.session("publisher").publish("steady", pose(1))


@pytest.mark.parametrize("name", ["", "a/b", "*", "a b" * 30, "ö", "@a"])
def test_a_name_is_one_plain_word(network: Network, name: str) -> None:
    with pytest.raises(ValueError):
        network.session(name)


def test_wake_interrupts_receive(network: Network) -> None:
    reader = network.session("reader")
    reader.wake()
    assert reader.receive(30.0) is None


def test_what_is_posted_stands_in_line_with_the_bus(network: Network) -> None:
    """From any thread, whatever it is, each once and in order."""
    bus = network.session("reader")
    posted = [("frame", number) for number in range(50)]
    thread = threading.Thread(target=lambda: [bus.post(event) for event in posted])
    thread.start()
    thread.join()
    assert network.collect(bus, lambda events: len(events) >= len(posted)) == posted


def test_closed_session_says_so(network: Network) -> None:
    publisher = network.session("publisher")
    publisher.publish("steady", pose(1))
    publisher.close()
    publisher.close()
    with pytest.raises(CannotOpen, match="closed"):
        publisher.publish("steady", pose(1))
    with pytest.raises(CannotOpen, match="closed"):
        publisher.subscribe("steady")
    with pytest.raises(CannotOpen, match="closed"):
        publisher.call("question", question(1), 1.0)
    with pytest.raises(CannotOpen, match="closed"):
        publisher.receive(0.1)
