"""A whole deployment for tests: started by `vantage up`, looked at by supervisord and the bus, broken on purpose."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from schemas import Control, Health, Players, Rules
from vantage.bus import Sample
from vantage.bus.zenoh_bus import ZenohBus
from vantage.deployment import Deployment, DeploymentError
from vantage.match import Match
from vantage.watch import HealthWatch, Verdict

VANTAGE = Path(sys.executable).parent / "vantage"
PATIENCE = 120.0
"""Seconds after which a state that has not come counts as missing. Bounds a failure only: a busy machine is slow, not wrong."""


class Table:
    """One deployment from start to end. `started` is the outcome of `vantage up`.

    Args:
        words: more options of `vantage up`.
        home: folder for everything, which is kept; default: a temporary one.
        up: whether to start it at the beginning.
    """

    def __init__(self, name: str = "simulation", *words: str, home: Path | None = None, up: bool = True) -> None:
        self.words = words
        self._starts = up
        self._is_kept = home is not None
        # Not pytest's folder: socket paths must be short.
        self.home = home or Path(tempfile.mkdtemp(prefix="vantage-test-", dir="/tmp"))
        self.home.mkdir(exist_ok=True)
        self.folder = self.home / "run"
        self.logs = self.home / "logs"
        self.deployment = Deployment(name, self.folder)

    def __enter__(self) -> Table:
        if self._starts:
            self.started = self.up()
        return self

    def __exit__(self, *_: object) -> None:
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                self.deployment.stop()
                break
            except DeploymentError:  # it waits for 20 s, which a busy machine may exceed
                if time.monotonic() > deadline:
                    raise
        if not self._is_kept:
            shutil.rmtree(self.home, ignore_errors=True)

    def up(self) -> subprocess.CompletedProcess[str]:
        return self.command("up", self.deployment.name, "--logs", str(self.logs), "--timeout", "200", *self.words)

    def command(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run `vantage` as people do, on this deployment."""
        return subprocess.run(
            [VANTAGE, *words, "--folder", str(self.folder)], capture_output=True, text=True, check=False, cwd=self.home
        )

    def services(self) -> list[str]:
        return list(self.deployment.programs)

    def pid_of(self, service: str) -> int:
        return next(process.pid for process in self.deployment.processes() if process.name == service)

    def wait_until_healthy(self, watch: HealthWatch, replaced: int = 0) -> None:
        """Listen until every service is healthy.

        Args:
            replaced: a process that must be gone.
        """

        def healthy() -> bool:
            verdicts = watch.verdicts()
            return not troubles(verdicts) and all(verdict.process.pid != replaced for verdict in verdicts)

        wait(healthy, lambda: watch.listen(0.05), lambda: f"not healthy: {troubles(watch.verdicts())}")

    def wait_until_reported(self, watch: HealthWatch) -> None:
        """Listen until every service has reported its health, well or not."""

        def silent() -> list[str]:
            return [verdict.process.name for verdict in watch.verdicts() if verdict.health is None]

        wait(lambda: not silent(), lambda: watch.listen(0.1), lambda: f"silent: {silent()}")


def wait(until: Callable[[], bool], turn: Callable[[], object], complaint: Callable[[], str]) -> None:
    """Take turns until a state has come; fails with the complaint when it does not."""
    deadline = time.monotonic() + PATIENCE
    while not until():
        assert time.monotonic() < deadline, complaint()
        turn()


def troubles(verdicts: list[Verdict]) -> dict[str, str]:
    return {verdict.process.name: f"{verdict.state}: {verdict.trouble}" for verdict in verdicts if not verdict.healthy}


@contextmanager
def stopped(pid: int) -> Iterator[None]:
    """Within, a process stands still."""
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def wish(seed: int, games: int, steps: int, period: float) -> Control:
    """Ask for games that always last `steps` steps: catches are ignored."""
    rules = Rules(maximum_steps=steps, catching=False, step_period=period)
    return Control(stamp=time.time_ns(), action="start", seed=seed, games=games, rules=rules, players=Players())


def follow(match: Match, until: Callable[[], bool], what: str) -> None:
    """Let a match go on until something is so."""
    wait(until, lambda: match.turn(0.05), lambda: f"{what}: it did not come to that (step {match.step} of {match.current})")


def stop_games(folder: Path) -> None:
    """Ask the referee to stop, and wait until its health shows that it was asked."""
    with ZenohBus("command-line", folder) as bus:
        bus.subscribe("health/referee")
        heard: list[int] = []

        def listen() -> None:
            event = bus.receive(0.2)
            if isinstance(event, Sample) and isinstance(health := event.decode(), Health):
                heard.append(sum(entry.received for entry in health.inputs if entry.key == "control"))

        wait(lambda: bool(heard) and bus.has_reader("control"), listen, lambda: "there is no referee")
        asked = heard[-1]
        bus.publish("control", Control(stamp=time.time_ns(), action="stop"))
        wait(lambda: heard[-1] > asked, listen, lambda: "the referee was not asked to stop")
