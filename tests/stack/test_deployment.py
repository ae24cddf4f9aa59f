"""The whole deployment under its supervisor: up, healthy, within its memory, played on, broken on purpose, down."""

from __future__ import annotations

import json
import os
import signal
import time
import warnings

import pytest

from tests.stack.table import Table, follow, stop_games, wish
from vantage.bus.zenoh_bus import ZenohBus
from vantage.log import find_logs, open_log
from vantage.match import Match
from vantage.watch import HealthWatch

SERVICES = ("recorder", "predictor", "referee", "simulator", "seeker", "planner", "console")
GIBIBYTE = 2**30
FLUSH_PERIOD = 1.0 + 0.1
"""Seconds: the recorder flushes at the first message after a second; 20 steps a second bring one at once."""


def test_up_ends_with_every_service_healthy_within_ten_seconds(table: Table) -> None:
    assert table.started.returncode == 0, table.started.stderr
    assert "services healthy" in table.started.stdout
    assert table.took < 10.0
    assert set(table.services()) == set(SERVICES)


def test_a_second_up_is_refused(table: Table) -> None:
    outcome = table.command("up", "simulation")
    assert outcome.returncode == 1
    assert "up already" in outcome.stderr


def test_a_game_is_played_on_the_terminal(table: Table) -> None:
    outcome = table.command("play", "--seed", "7", "--period", "0", "--steps", "40")
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    assert "(seed 7): the hider" in outcome.stdout
    assert "planned in" in outcome.stdout


def test_status_counts_memory_below_a_gibibyte_after_a_game(table: Table) -> None:
    outcome = table.command("status", "--json")
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    document = json.loads(outcome.stdout)
    assert document["healthy"]
    assert {row["service"] for row in document["services"]} == set(SERVICES)
    assert all(row["pid"] > 0 and row["restarts"] == 0 and row["memory_bytes"] > 2**20 for row in document["services"])
    assert sum(row["memory_bytes"] for row in document["services"]) < document["memory_bytes"] <= GIBIBYTE


def test_logs_shows_what_a_service_printed(table: Table) -> None:
    outcome = table.command("logs", "seeker")
    assert outcome.returncode == 0
    assert "seeker started" in outcome.stdout


@pytest.mark.parametrize("service", SERVICES)
@pytest.mark.parametrize("fault", ["kill -9", "stop for 5 s"])
def test_a_fault_in_mid_game_heals(table: Table, fault: str, service: str) -> None:
    with HealthWatch(table.deployment) as watch, ZenohBus("command-line", table.folder) as bus:
        table.wait_until_healthy(watch, 20.0)
        # Short horizons are planned quickly: six checkpoints instead of the paper's ten.
        match = Match(bus, wish(seed=11, games=10, steps=60, period=0.1))
        follow(match, lambda: match.step >= 10, 30.0, "the game gets to step 10")
        assert match.current is not None
        pid = table.pid_of(service)
        hurt = time.time()
        if fault == "kill -9":
            os.kill(pid, signal.SIGKILL)
        else:
            os.kill(pid, signal.SIGSTOP)
            try:
                resume = time.monotonic() + 5.0
                while time.monotonic() < resume:
                    match.turn(0.05)
            finally:
                os.kill(pid, signal.SIGCONT)
        before = (match.current.episode if match.current else 0, match.step)
        table.wait_until_healthy(watch, 5.0, replaced=pid if fault == "kill -9" else 0)

        def goes_on() -> bool:
            """The same game at a later step, or another game under way."""
            current = match.current
            return current is not None and match.step > (before[1] if current.episode == before[0] else 0)

        follow(match, goes_on, 20.0, "the game goes on, or a new one runs")
    stop_games(table.folder)
    assert newest_before(table, hurt) > hurt - FLUSH_PERIOD


def newest_before(table: Table, moment: float) -> float:
    """When the last message that reads back from the logs and was logged before `moment` was logged, s since the Unix epoch."""
    newest = 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for parts in find_logs(table.logs):
            with open_log(*parts) as log:
                newest = max([newest, *(record.log_time / 1e9 for record in log.records() if record.log_time / 1e9 <= moment)])
    return newest


def test_down_stops_everything(table: Table) -> None:
    pids = [process.pid for process in table.deployment.processes() if process.pid]
    outcome = table.command("down")
    assert outcome.returncode == 0
    assert "is down" in outcome.stdout
    assert not any(os.path.exists(f"/proc/{pid}") for pid in pids)
    assert table.command("status").returncode == 1
