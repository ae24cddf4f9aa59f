"""Games end with the command that asked for them, however it ends; detached ones go on until somebody stops them."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import time
from collections.abc import Callable, Iterator

import pytest

from schemas import Episode
from tests.stack.conftest import PAUSE
from tests.stack.table import VANTAGE, Table
from vantage.bus import Sample
from vantage.bus.zenoh_bus import ZenohBus

PATIENCE = 30.0
FOLLOWS = 2.0 * PAUSE + 0.5
"""Seconds within which another game would have followed."""


class Watcher:
    """Hears what the referee publishes of games."""

    def __init__(self, bus: ZenohBus) -> None:
        self.bus = bus
        self.episodes: list[Episode] = []

    def wait(self, what: Callable[[Episode], bool], timeout: float = PATIENCE) -> Episode:
        """Return the next word on a game of which something is so."""
        end = time.monotonic() + timeout
        while True:
            event = self.bus.receive(0.1)
            if isinstance(event, Sample):
                message = event.decode()
                assert isinstance(message, Episode)
                self.episodes.append(message)
                if what(message):
                    return message
            assert time.monotonic() < end, f"only {[(e.episode, e.phase, e.reason) for e in self.episodes]}"

    def rest(self, seconds: float) -> list[Episode]:
        """Return what comes in some seconds."""
        end, count = time.monotonic() + seconds, len(self.episodes)
        while (left := end - time.monotonic()) > 0:
            event = self.bus.receive(left)
            if isinstance(event, Sample):
                self.episodes.append(event.decode())  # type: ignore[arg-type]
        return self.episodes[count:]


@pytest.fixture
def watcher(table: Table) -> Iterator[Watcher]:
    assert table.started.returncode == 0, table.started.stderr
    with ZenohBus("watch-test", table.folder) as bus:
        bus.subscribe("episode")
        watcher = Watcher(bus)
        watcher.rest(0.5)  # the latched game of an earlier test
        yield watcher


def start(table: Table, *words: str) -> subprocess.Popen[str]:
    command = [str(VANTAGE), "play", "--folder", str(table.folder), *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=table.home)


def runs(episode: Episode) -> bool:
    return episode.phase == "running"


def is_over(episode: Episode) -> bool:
    return episode.phase in ("ended", "aborted")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_games_and_tells_how_to_go_on(table: Table, watcher: Watcher, number: signal.Signals) -> None:
    process = start(table, "--seed", "40", "--games", "3", "--steps", "200")
    watcher.wait(runs)
    process.send_signal(number)
    before = time.monotonic()
    aborted = watcher.wait(is_over)
    _, complained = process.communicate(timeout=PATIENCE)
    assert time.monotonic() - before < 5.0
    assert (aborted.phase, aborted.reason) == ("aborted", "stopped: `vantage play` has ended")
    assert process.returncode == 128 + number
    assert complained.count("\n") == 1 and "0 of 3 games played" in complained
    assert f"vantage play --seed 40 --games 3 --steps 200 --folder {table.folder}" in complained
    assert watcher.rest(FOLLOWS) == [], "no other game follows"


def test_a_closed_terminal_ends_the_games(table: Table, watcher: Watcher) -> None:
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(table.home)
        os.execv(VANTAGE, [str(VANTAGE), "play", "--folder", str(table.folder), "--games", "3", "--steps", "200"])
    try:
        watcher.wait(runs)
        os.close(terminal)
        assert watcher.wait(is_over).reason == "stopped: `vantage play` has ended"
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    assert watcher.rest(FOLLOWS) == []


def test_a_killed_command_takes_its_games_with_it_and_a_stopped_one_does_not(table: Table, watcher: Watcher) -> None:
    process = start(table, "--games", "3", "--steps", "200")
    try:
        watcher.wait(runs)
        process.send_signal(signal.SIGSTOP)
        assert not [episode for episode in watcher.rest(2.0) if is_over(episode)]
        process.send_signal(signal.SIGCONT)
    finally:
        process.kill()
    before = time.monotonic()
    aborted = watcher.wait(is_over)
    assert time.monotonic() - before < 4.0, "two seconds, on a machine that has nothing else to do"
    assert aborted.reason == "stopped: the command that asked for these games has ended"
    process.communicate()
    assert watcher.rest(FOLLOWS) == []


def test_detached_games_go_on_until_they_are_stopped(table: Table, watcher: Watcher) -> None:
    outcome = table.command("play", "--games", "3", "--steps", "200", "--detach")
    assert outcome.returncode == 0, outcome.stderr
    assert outcome.stdout.count("\n") == 1
    assert "3 games from seed 1 asked for: watch at http://" in outcome.stdout
    assert f"vantage stop --folder {table.folder}" in outcome.stdout
    watcher.wait(runs)
    assert watcher.rest(2.5) == []
    outcome = table.command("stop")
    assert outcome.returncode == 0, outcome.stderr
    assert "has ended at step" in outcome.stdout and "none follows" in outcome.stdout
    assert watcher.wait(is_over).reason == "stopped: `vantage stop`"
    assert watcher.rest(FOLLOWS) == []
    outcome = table.command("stop")
    assert (outcome.returncode, outcome.stdout) == (0, "no game was being played; none follows\n")


def test_games_that_somebody_else_stops_are_not_asked_for_again(table: Table, watcher: Watcher) -> None:
    process = start(table, "--games", "3", "--steps", "200")
    watcher.wait(runs)
    assert table.command("stop").returncode == 0
    said, complained = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1 and complained == ""
    assert "aborted at step" in said and "2 of 3 games not begun: `vantage stop`" in said
    assert not [episode for episode in watcher.rest(FOLLOWS) if episode.phase == "setup"]


def test_a_human_who_does_not_come_leaves_nothing_paused(table: Table, watcher: Watcher) -> None:
    process = start(table, "--hider", "human", "--steps", "50")
    assert process.stdout is not None
    said = process.stdout.readline()
    assert said.startswith("a human drives the hider: open http://")
    watcher.wait(lambda episode: episode.paused)
    process.send_signal(signal.SIGINT)
    aborted = watcher.wait(is_over)
    assert not aborted.paused
    process.communicate(timeout=PATIENCE)
    outcome = table.command("play", "--steps", "5", "--period", "0", "--seed", "3")
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    assert "(seed 3): the hider" in outcome.stdout


def test_a_second_command_is_told_of_the_first(table: Table, watcher: Watcher) -> None:
    process = start(table, "--steps", "200")
    try:
        watcher.wait(runs)
        outcome = table.command("play")
        assert outcome.returncode == 1
        assert "by another command" in outcome.stderr and outcome.stderr.count("\n") == 1
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE)
