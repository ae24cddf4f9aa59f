"""A service on a busy machine: how late it runs is measured, said, and held against nobody else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from schemas import Tick
from vantage.bus import InProcessNetwork, VirtualClock
from vantage.service import SECOND, Arrived, Declaration, Received, Runtime, Send, Woken

MILLISECOND = SECOND // 1000


@dataclass
class Waiting:
    """A core that waits for a tick until a deadline, and takes long over each event if told to."""

    clock: VirtualClock
    deadline: int
    takes: int = 0
    heard: list[str] = field(default_factory=list)
    lags: list[int] = field(default_factory=list)
    declaration: Declaration = field(default_factory=lambda: Declaration(name="seeker", inputs=("tick",)))

    def held_up(self, lag: int, now: int) -> None:
        self.lags.append(lag)
        self.deadline += lag

    def step(self, received: Received, now: int) -> Sequence[Send]:
        self.clock.now += self.takes
        if isinstance(received, Arrived):
            self.heard.append("tick")
        elif isinstance(received, Woken) and now >= self.deadline:
            self.heard.append("too late")
            self.deadline = now + 3600 * SECOND
        return ()

    def wake_at(self) -> int | None:
        return self.deadline


class BusyMachine:
    """A session on a machine where waiting takes `late` ns longer than asked."""

    def __init__(self, session: Any, clock: VirtualClock) -> None:
        self._session, self._clock, self.late = session, clock, 0

    def receive(self, timeout: float) -> Any:
        event = self._session.receive(0.0)
        if event is None and timeout > 0.0:
            self._clock.now += round(timeout * SECOND) + self.late
            event = self._session.receive(0.0)
        return event

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)


def make(deadline: float) -> tuple[Waiting, Runtime, BusyMachine, Any]:
    clock = VirtualClock(1000 * SECOND)
    network = InProcessNetwork(clock=clock)
    bus = BusyMachine(network.session("seeker"), clock)
    core = Waiting(clock, clock.now + int(deadline * SECOND))
    return core, Runtime(core, bus, clock), bus, network.session("referee")  # type: ignore[arg-type]


def test_what_came_in_time_is_heard_before_time_is_up() -> None:
    core, runtime, _, referee = make(1.0)
    for step in range(3):
        referee.publish("tick", Tick(stamp=1, episode=1, step=step))
    core.clock.now += 2 * SECOND  # the service did not run, and all its ticks are there
    while "too late" not in core.heard:
        runtime.turn(0.1)
    assert core.heard == ["tick", "tick", "tick", "too late"]


def test_a_delay_is_told_to_the_core_before_anything_else() -> None:
    core, runtime, bus, referee = make(1.0)
    bus.late = 3 * SECOND
    runtime.turn(0.1)
    referee.publish("tick", Tick(stamp=1, episode=1, step=0))
    bus.late = 0
    runtime.turn(0.1)
    assert core.lags == [3 * SECOND] and core.heard == ["tick"]
    for _ in range(5):
        runtime.turn(0.1)
    assert core.heard == ["tick"]  # of its second only half a one has passed while it ran
    for _ in range(15):
        runtime.turn(0.1)
    assert core.heard == ["tick", "too late"]


def test_its_own_work_is_a_delay_too() -> None:
    core, runtime, _, referee = make(10.0)
    core.takes = SECOND
    referee.publish("tick", Tick(stamp=1, episode=1, step=0))
    runtime.turn(0.1)
    runtime.turn(0.1)
    assert core.lags == [SECOND]


def test_a_service_in_time_is_not_held_up() -> None:
    core, runtime, bus, referee = make(3600.0)
    bus.late = 20 * MILLISECOND
    for step in range(50):
        referee.publish("tick", Tick(stamp=1, episode=1, step=step))
        runtime.turn(0.1)
        runtime.turn(0.1)
    assert core.lags == []
    assert runtime.health_report("ok").reason == ""


def test_health_says_that_the_machine_is_too_slow_with_figures_and_for_how_long() -> None:
    core, runtime, bus, _ = make(3600.0)
    bus.late = 6 * SECOND
    runtime.turn(0.1)
    bus.late = 0
    runtime.turn(0.1)
    assert core.lags == [6 * SECOND]
    assert runtime.health_report("ok").reason == ""  # somebody stopped the process, or the machine slept
    core.lags.clear()
    while core.clock.now < 1017 * SECOND:
        runtime.turn(0.1)
    assert core.lags == []
    bus.late = 700 * MILLISECOND
    for _ in range(3):
        runtime.turn(0.1)
    bus.late = 0
    runtime.turn(0.1)
    health = runtime.health_report("ok")
    assert health.state == "degraded"
    assert health.reason.startswith("this machine is too slow: seeker ran up to 0.7 s late 3 times in 10 s; load ")
    assert " core" in health.reason and health.reason.endswith("stop other programs")
    core.clock.now += 11 * SECOND
    assert runtime.health_report("ok").reason == ""
