"""The whole deployment under its supervisor: up, healthy, within its memory, played on, broken on purpose."""

from __future__ import annotations

import json
import os
import signal
import time
import warnings
from collections.abc import Iterator

import pytest

from schemas import Tick
from tests.stack.table import PATIENCE, Table, follow, stop_games, stopped, troubles, wait, wish
from vantage.bus.zenoh_bus import ZenohBus
from vantage.log import find_logs, open_log
from vantage.match import Match
from vantage.watch import HealthWatch

SERVICES = ("recorder", "predictor", "referee", "simulator", "seeker", "planner", "console")
GIBIBYTE = 2**30


def test_up_ends_with_every_service_healthy(table: Table) -> None:
    assert table.started.returncode == 0, table.started.stderr
    assert "services healthy" in table.started.stdout
    assert set(table.services()) == set(SERVICES)


def test_a_second_up_is_refused(table: Table) -> None:
    outcome = table.command("up", "simulation")
    assert outcome.returncode == 1
    assert "up already" in outcome.stderr


def test_a_game_is_played_on_the_terminal(table: Table) -> None:
    outcome = table.command("play", "--seed", "7", "--period", "0", "--steps", "10")
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    assert "(seed 7): the hider" in outcome.stdout
    assert "planned in" in outcome.stdout


def test_status_counts_memory_below_a_gibibyte_after_a_game(table: Table) -> None:
    deadline = time.monotonic() + PATIENCE
    while (outcome := table.command("status", "--json")).returncode != 0:  # a busy machine is late with its health
        assert time.monotonic() < deadline, outcome.stdout + outcome.stderr
    document = json.loads(outcome.stdout)
    assert document["healthy"]
    assert {row["service"] for row in document["services"]} == set(SERVICES)
    assert all(row["pid"] > 0 and row["restarts"] == 0 and row["memory_bytes"] > 2**20 for row in document["services"])
    assert sum(row["memory_bytes"] for row in document["services"]) < document["memory_bytes"] <= GIBIBYTE


def test_logs_shows_what_a_service_printed(table: Table) -> None:
    outcome = table.command("logs", "seeker")
    assert outcome.returncode == 0
    assert "seeker started" in outcome.stdout


@pytest.fixture(scope="module")
def games(table: Table) -> Iterator[tuple[HealthWatch, Match]]:
    """Games without end, and a watch on everybody's health."""
    with HealthWatch(table.deployment) as watch:
        with ZenohBus("command-line", table.folder) as bus:
            # Short horizons are planned quickly: six checkpoints instead of the paper's ten.
            yield watch, Match(bus, wish(seed=11, games=1000, steps=60, period=0.1))
        stop_games(table.folder)


def go_on(match: Match) -> None:
    """Wait until the same game gets to a later step, or another one is under way."""
    game, step = (match.current.episode if match.current else 0), match.step

    def goes_on() -> bool:
        current = match.current
        return current is not None and match.step > (step if current.episode == game else 0)

    follow(match, goes_on, "the game goes on, or a new one runs")


def begin(table: Table, watch: HealthWatch, match: Match) -> None:
    follow(match, lambda: match.current is not None and match.step >= 2, "a game is under way")
    table.wait_until_healthy(watch)
    go_on(match)


@pytest.mark.parametrize("service", SERVICES)
def test_who_is_killed_in_mid_game_comes_again(table: Table, games: tuple[HealthWatch, Match], service: str) -> None:
    watch, match = games
    begin(table, watch, match)
    pid, kept = table.pid_of(service), recorded_ticks(table)
    os.kill(pid, signal.SIGKILL)
    table.wait_until_healthy(watch, replaced=pid)
    go_on(match)
    if service == "recorder":
        assert kept
        assert recorded_ticks(table) >= kept
        assert len(find_logs(table.logs)) >= 2
        wait_until_recorded(table, match)


@pytest.mark.parametrize("service", SERVICES)
def test_who_stands_still_is_noticed_and_goes_on(table: Table, games: tuple[HealthWatch, Match], service: str) -> None:
    watch, match = games
    begin(table, watch, match)
    with stopped(table.pid_of(service)):
        wait(lambda: service in troubles(watch.verdicts()), lambda: (watch.listen(0.05), match.turn(0.0)), lambda: "unnoticed")
    table.wait_until_healthy(watch)
    go_on(match)


def wait_until_recorded(table: Table, match: Match) -> None:
    """Wait until a step that is played now can be read back from the log."""
    assert match.current is not None
    now = match.current.episode, match.step
    wait(lambda: now in recorded_ticks(table), lambda: match.turn(0.2), lambda: f"step {now} is not recorded")


def recorded_ticks(table: Table) -> set[tuple[int, int]]:
    """(episode, step) of every tick that reads back from the logs, of which the last is being written."""
    ticks: set[tuple[int, int]] = set()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for parts in find_logs(table.logs):
            with open_log(*parts) as log:
                said = [record.decode() for record in log.records({"tick"}) if record.publisher == "referee"]
                ticks.update((tick.episode, tick.step) for tick in said if isinstance(tick, Tick))
    return ticks
