"""Health is as old as its arrival says, on the clock of whoever listens: wall clocks are set and machines are suspended."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from schemas import Health
from vantage.bus.zenoh_bus import ZenohBus
from vantage.deployment import Deployment, Process
from vantage.watch import STALE_HEALTH, HealthWatch, judge

PROCESS = Process("referee", "RUNNING", os.getpid(), restarts=0, uptime=9.0, memory=1, complaint="")


class One(Deployment):
    """A deployment whose supervisord knows one process: this one."""

    def processes(self) -> list[Process]:
        return [PROCESS]


@pytest.fixture
def referee(home: Path) -> Iterator[ZenohBus]:
    with ZenohBus("referee", home) as bus:
        yield bus


def health(stamp: int) -> Health:
    return Health(stamp=stamp, service="referee", state="ok", process=os.getpid(), uptime=9.0)


@pytest.mark.stack
@pytest.mark.parametrize("hours", [-1, 1])
def test_a_service_on_another_clock_is_not_silent_and_becomes_so_when_it_stops(home: Path, referee: ZenohBus, hours: int) -> None:
    with HealthWatch(One("small", home)) as watch:
        deadline = time.monotonic() + 20.0
        while watch.verdicts()[0].health is None:
            referee.publish("health/referee", health(time.time_ns() + hours * 3600 * 10**9))
            watch.listen(0.1)
            assert time.monotonic() < deadline, "nothing heard"
        assert watch.verdicts()[0].healthy
        watch.listen(STALE_HEALTH + 0.2)
        assert watch.verdicts()[0].state == "silent"


@pytest.mark.stack
def test_what_waited_while_no_one_listened_is_not_taken_for_news(home: Path, referee: ZenohBus) -> None:
    with HealthWatch(One("small", home)) as watch:
        deadline = time.monotonic() + 20.0
        while not referee.has_reader("health/referee"):
            referee.receive(0.05)
            assert time.monotonic() < deadline, "no one reads health"
        referee.publish("health/referee", health(time.time_ns()))
        later = time.monotonic() + STALE_HEALTH + 0.5
        while time.monotonic() < later:  # the watcher is busy elsewhere; the publisher goes on living
            referee.receive(0.1)
        watch.listen(0.1)
        assert watch.verdicts()[0].state == "silent"


def test_what_a_service_prints_to_health_is_safe_on_a_terminal() -> None:
    sick = Health(stamp=1, service="referee", state="degraded", process=os.getpid(), uptime=9.0, reason="\x1b[2Jevil\nline")
    assert judge(PROCESS, sick, 0.1).trouble == "[2Jevil line"
