"""The service runtime: joins, counts, health, calls, in-process runs."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations

import pytest

from schemas import Command, Episode, Health, Pose, PredictReply, PredictRequest, Tick
from vantage.bus import InProcessNetwork, Lost, Sample, VirtualClock
from vantage.deployment import Process
from vantage.service import (
    SECOND,
    Answer,
    Answered,
    Arrived,
    Ask,
    Asked,
    Changed,
    Declaration,
    Publish,
    Received,
    Refuse,
    Runtime,
    Send,
    StepJoin,
    Unexpected,
    Woken,
    bad_messages,
    run_in_process,
)
from vantage.watch import judge

KEYS = ("hider/pose", "tick")


def pose(episode: int, step: int) -> Pose:
    return Pose(stamp=step, episode=episode, step=step, x=0.1, y=0.2, heading=0.0)


def tick(episode: int, step: int) -> Tick:
    return Tick(stamp=step, episode=episode, step=step)


@dataclass
class Probe:
    """A core that notes what it receives and does as told."""

    declaration: Declaration
    received: list[Received] = field(default_factory=list)
    answers: list[Sequence[Send] | Exception] = field(default_factory=list)
    wake: int | None = None

    def step(self, received: Received, now: int) -> Sequence[Send]:
        self.received.append(received)
        if isinstance(received, Woken):
            self.wake = None
        answer = self.answers.pop(0) if self.answers else ()
        if isinstance(answer, Exception):
            raise answer
        return answer

    def wake_at(self) -> int | None:
        return self.wake


def network() -> InProcessNetwork:
    return InProcessNetwork(clock=VirtualClock(5 * SECOND))


def probe(bus: InProcessNetwork, name: str, **declared: tuple[str, ...]) -> tuple[Probe, Runtime]:
    core = Probe(Declaration(name=name, **declared))  # type: ignore[arg-type]
    return core, Runtime(core, bus.session(name), bus.clock, health=False)


# One publisher's messages stay in order, so 0 comes before 2 and 1 before 3.
ORDERS = [order for order in permutations(range(4)) if order.index(0) < order.index(2) and order.index(1) < order.index(3)]


@pytest.mark.parametrize("order", ORDERS)
def test_join_completes_a_step_in_any_order(order: tuple[int, ...]) -> None:
    join = StepJoin(KEYS)
    join.begin(1)
    messages = [("hider/pose", pose(1, 0)), ("tick", tick(1, 0)), ("hider/pose", pose(1, 1)), ("tick", tick(1, 1))]
    complete = [joined for index in order if (joined := join.add(*messages[index])) is not None]
    assert complete[-1] == (pose(1, 1), tick(1, 1))
    assert all(joined[0].step == joined[1].step for joined in complete)


def test_join_keeps_messages_that_come_before_their_episode() -> None:
    join = StepJoin(KEYS)
    join.begin(1)
    assert join.add("hider/pose", pose(2, 0)) is None
    assert join.add("tick", tick(2, 0)) is None
    assert join.begin(2) == (pose(2, 0), tick(2, 0))


def test_join_forgets_what_was_left_of_earlier_episodes() -> None:
    join = StepJoin(KEYS)
    for episode in range(1, 50):
        join.begin(episode)
        join.add("hider/pose", pose(episode, 0))  # the last poses of a game get no tick
    join.begin(50)
    assert len(join._waiting) == 0
    assert join.add("tick", tick(50, 0)) is None
    assert join.add("hider/pose", pose(50, 0)) == (pose(50, 0), tick(50, 0))


def test_join_refuses_the_past_and_doubles() -> None:
    join = StepJoin(KEYS)
    join.begin(3)
    join.add("tick", tick(3, 0))
    with pytest.raises(Unexpected, match="twice"):
        join.add("tick", tick(3, 0))
    join.add("hider/pose", pose(3, 0))
    with pytest.raises(Unexpected, match="late"):
        join.add("tick", tick(3, 0))
    with pytest.raises(Unexpected, match="late"):
        join.add("tick", tick(2, 5))


def test_join_is_bounded_against_a_flood_of_strangers() -> None:
    join = StepJoin(KEYS)
    join.begin(1)
    for step in range(10_000):
        join.add("tick", tick(99, step))
    assert len(join._waiting) <= StepJoin.EARLY
    for step in range(1, 10_000):
        join.add("tick", tick(1, step))
    assert len(join._waiting) <= StepJoin.EARLY


def test_join_plays_on_through_a_flood() -> None:
    join = StepJoin(KEYS)
    join.begin(1)
    join.add("tick", tick(1, 0))
    for step in range(100):
        join.add("tick", tick(99, step))
    assert join.add("hider/pose", pose(1, 0)) == (pose(1, 0), tick(1, 0))


def test_join_forgets_a_step_that_lost_a_message() -> None:
    join = StepJoin(KEYS)
    join.begin(1)
    for step in range(1000):
        join.add("hider/pose", pose(1, 2 * step))
        join.add("hider/pose", pose(1, 2 * step + 1))
        assert join.add("tick", tick(1, 2 * step + 1)) is not None
    assert not join._waiting


def test_who_joins_late_joins_at_the_latest_step() -> None:
    join = StepJoin(KEYS)
    for step in (7, 8):
        join.add("hider/pose", pose(1, step))
        join.add("tick", tick(1, step))
    assert join.begin(1) == (pose(1, 8), tick(1, 8))
    with pytest.raises(Unexpected, match="late"):
        join.add("tick", tick(1, 7))


def test_a_core_that_raises_is_counted_and_goes_on() -> None:
    bus = network()
    core, runtime = probe(bus, "seeker", inputs=("tick",), outputs=("seeker/command",))
    referee = bus.session("referee")
    command = Command(stamp=1, primitive="stay")
    core.answers = [Unexpected("odd"), RuntimeError("broken"), (Publish("seeker/command", command),)]
    listener = bus.session("console")
    listener.subscribe("seeker/command")
    for step in range(3):
        referee.publish("tick", tick(1, step))
    runtime.drain()
    health = runtime.health_report("ok")
    assert (health.unexpected, health.failed) == (1, 1)
    assert "broken" in health.reason
    sample = listener.receive(0.0)
    assert isinstance(sample, Sample)
    assert sample.decode() == command


def test_a_core_that_raises_at_every_message_is_not_healthy_until_it_handles_them_again() -> None:
    bus = network()
    core, runtime = probe(bus, "seeker", inputs=("tick",))
    referee = bus.session("referee")
    core.answers = [TypeError("unexpected keyword argument 'speed'")] * 20
    process = Process("seeker", "RUNNING", pid=os.getpid(), restarts=0, uptime=9.0, memory=1, complaint="")
    for step in range(20):
        referee.publish("tick", tick(1, step))
        runtime.drain()
        health = runtime.health_report("ok")
        assert health.state == "degraded"
        assert health.reason == "tick from referee: TypeError: unexpected keyword argument 'speed'"
        verdict = judge(process, health, age=0.1)
        assert not verdict.healthy
        assert "TypeError" in verdict.trouble
    bus.clock.now += 11 * SECOND
    referee.publish("tick", tick(1, 20))
    runtime.drain()
    health = runtime.health_report("ok")
    assert (health.state, health.reason, health.failed) == ("ok", "", 20)
    assert judge(process, health, age=0.1).healthy


def test_a_message_that_is_set_aside_does_not_make_a_service_unhealthy() -> None:
    bus = network()
    core, runtime = probe(bus, "seeker", inputs=("tick",))
    core.answers = [Unexpected("odd")]
    bus.session("referee").publish("tick", tick(1, 0))
    runtime.drain()
    health = runtime.health_report("ok")
    assert (health.state, health.reason) == ("ok", "set aside: tick from referee: odd")


def test_the_log_says_what_was_bad_but_not_a_line_for_each(caplog: pytest.LogCaptureFixture) -> None:
    bus = network()
    core, runtime = probe(bus, "seeker", inputs=("tick",))
    referee = bus.session("referee")
    core.answers = [Unexpected("odd\x1b[2J")] * 101
    for step in range(100):
        referee.publish("tick", tick(1, step))
    runtime.drain()
    bus.clock.now += 2 * SECOND
    referee.publish("tick", tick(1, 100))
    runtime.drain()
    first = "set aside: tick from referee: odd[2J"
    assert caplog.messages == [first, f"{first} (and 99 more bad messages before it)"]
    assert bad_messages(runtime.health_report("ok")) == 101


def test_an_output_that_is_not_declared_is_refused() -> None:
    bus = network()
    core, runtime = probe(bus, "seeker", inputs=("tick",), outputs=())
    core.answers = [(Publish("seeker/command", Command(stamp=1, primitive="stay")),)]
    bus.session("referee").publish("tick", tick(1, 0))
    runtime.drain()
    assert runtime.health_report("ok").failed == 1


def test_declaring_an_unknown_key_is_refused() -> None:
    with pytest.raises(ValueError, match="nowhere"):
        Declaration(name="seeker", inputs=("nowhere",))


def test_health_names_the_stale_topic_its_publisher_age_and_rate() -> None:
    bus = network()
    _, runtime = probe(bus, "seeker", inputs=("episode", "tick"))
    referee = bus.session("referee")
    referee.publish("episode", Episode(stamp=1, episode=1, seed=1, phase="running"))
    referee.publish("tick", tick(1, 0))
    runtime.drain()
    assert runtime.health_report("ok").state == "ok"
    bus.clock.advance(4.2)  # type: ignore[attr-defined]
    health = runtime.health_report("ok")
    assert health.state == "degraded"
    assert "tick from referee is 4.2 s old, expected 4 a second" in health.reason
    assert {entry.key: entry.stale for entry in health.inputs} == {"episode": False, "tick": True}


def test_nothing_is_stale_in_a_pause_nor_at_once_when_the_game_goes_on() -> None:
    bus = network()
    _, runtime = probe(bus, "seeker", inputs=("episode", "tick"))
    referee = bus.session("referee")

    def say(phase: str, paused: bool = False) -> None:
        referee.publish("episode", Episode(stamp=1, episode=1, seed=1, phase=phase, paused=paused))  # type: ignore[arg-type]
        runtime.drain()

    def is_stale_after(seconds: float) -> bool:
        bus.clock.advance(seconds)  # type: ignore[attr-defined]
        health = runtime.health_report("ok")
        assert health.state == ("degraded" if any(entry.stale for entry in health.inputs) else "ok")
        return health.state == "degraded"

    say("running")
    referee.publish("tick", tick(1, 0))
    say("running", paused=True)
    assert not is_stale_after(600.0)
    say("running")
    assert not is_stale_after(2.4)
    assert is_stale_after(0.2)
    say("running")  # said again by a game that was not paused: nothing is younger for it
    assert is_stale_after(0.0)
    referee.publish("tick", tick(1, 1))
    runtime.drain()
    assert not is_stale_after(2.4)
    say("ended")
    assert not is_stale_after(600.0)
    say("running")  # the next game: what was said in the last one is not stale before it could come again
    assert not is_stale_after(2.4)
    assert is_stale_after(0.2)


def test_health_is_published_once_a_second() -> None:
    bus = network()
    core = Probe(Declaration(name="seeker", outputs=("health/seeker",)))
    runtime = Runtime(core, bus.session("seeker"), bus.clock)
    listener = bus.session("console")
    listener.subscribe("health/*")
    for _ in range(30):
        runtime.turn(0.0)
        bus.clock.advance(0.1)  # type: ignore[attr-defined]
    reports = []
    while (event := listener.receive(0.0)) is not None:
        assert isinstance(event, Sample)
        reports.append(event.decode())
    assert len(reports) == 3
    assert all(isinstance(report, Health) and report.service == "seeker" for report in reports)


def test_heeded_services_are_reported_to_the_core_and_in_health() -> None:
    bus = network()
    core, runtime = probe(bus, "referee", heeds=("seeker",))
    assert "seeker is not alive" in runtime.health_report("ok").reason
    seeker = bus.session("seeker")
    runtime.drain()
    seeker.close()
    runtime.drain()
    assert core.received == [Changed("seeker", True), Changed("seeker", False)]


def request() -> PredictRequest:
    return PredictRequest(stamp=1, state_image=bytes(128 * 128), path_count=1, path_steps=1, paths=bytes(8), horizons=(0,))


def test_calls_travel_through_both_runtimes() -> None:
    bus = network()
    server_core, server = probe(bus, "predictor", serves=("predictor",))
    client_core, client = probe(bus, "planner", inputs=("tick",), calls=("predictor",))
    reply = PredictReply(stamp=1, caught=bytes(4))
    client_core.answers = [(Ask("predictor", request(), 1.0, 77),)]
    server_core.answers = [()]
    bus.session("referee").publish("tick", tick(1, 0))
    client.drain()
    server.drain()
    asked = server_core.received[-1]
    assert isinstance(asked, Asked)
    server_core.answers = [(Answer(asked.token, reply),)]
    server_core.wake = 0
    server.drain()
    client.drain()
    assert client_core.received[-1] == Answered("predictor", 77, reply, "")


def test_a_refused_call_brings_its_reason() -> None:
    bus = network()
    server_core, server = probe(bus, "predictor", serves=("predictor",))
    client_core, client = probe(bus, "planner", inputs=("tick",), calls=("predictor",))
    client_core.answers = [(Ask("predictor", request(), 1.0, 1),)]
    bus.session("referee").publish("tick", tick(1, 0))
    client.drain()
    server_core.step = lambda received, now: (Refuse(received.token, "too busy"),)  # type: ignore
    server.drain()
    client.drain()
    answered = client_core.received[-1]
    assert isinstance(answered, Answered) and answered.reply is None and "too busy" in answered.error


def test_run_in_process_jumps_to_the_next_wake_and_complains_when_all_are_idle() -> None:
    bus = network()
    core, runtime = probe(bus, "seeker")
    core.wake = 1000 * SECOND
    run_in_process(bus, [runtime], lambda: bool(core.received))
    assert bus.clock() == 1000 * SECOND
    with pytest.raises(RuntimeError, match="idle"):
        run_in_process(bus, [runtime], lambda: False)


def test_malformed_messages_are_counted_by_topic() -> None:
    bus = InProcessNetwork(clock=VirtualClock(0), checked=True)
    core, runtime = probe(bus, "seeker", inputs=("seeker/pose",))
    bus.session("simulator").publish("seeker/pose", Pose(stamp=1, x=1e9, y=0.0, heading=0.0))
    runtime.drain()
    health = runtime.health_report("ok")
    assert core.received == []
    assert health.inputs[0].malformed == 1
    assert "seeker/pose from simulator was malformed" in health.reason


def test_lost_messages_are_added_up_by_topic() -> None:
    bus = network()
    core, runtime = probe(bus, "seeker", inputs=("tick", "seeker/pose"))
    for event in (Lost("tick", "referee", 3), Lost("seeker/pose", "simulator", 1), Lost("tick", "referee", 2)):
        runtime._handle(event, bus.clock())
    assert {entry.key: entry.lost for entry in runtime.health_report("ok").inputs} == {"tick": 5, "seeker/pose": 1}
    assert core.received == []


def test_arrived_messages_reach_the_core() -> None:
    bus = network()
    core, runtime = probe(bus, "seeker", inputs=("tick",))
    bus.session("referee").publish("tick", tick(4, 2))
    runtime.drain()
    assert core.received == [Arrived("tick", tick(4, 2))]


@pytest.mark.parametrize("over", [2, 1])
def test_who_goes_back_with_a_replay_joins_there_whatever_comes_first(over: int) -> None:
    """Topics are not ordered among each other: what belongs to the episode gone back to may come before the episode."""
    join = StepJoin(KEYS)
    join.begin(over)
    for step in range(10):
        join.add("hider/pose", pose(over, step))
        join.add("tick", tick(over, step))
    with pytest.raises(Unexpected, match="late"):
        join.add("hider/pose", pose(1, 4))
    assert join.begin(1) is None
    assert join.add("tick", tick(1, 4)) == (pose(1, 4), tick(1, 4))
    assert join.begin(1) is None, "nothing is left of it"
