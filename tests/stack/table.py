"""A whole deployment for tests: started by `vantage up`, looked at by supervisord and the bus, broken on purpose."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

from schemas import Control, Players, Rules
from vantage.bus.zenoh_bus import ZenohBus
from vantage.deployment import Deployment
from vantage.match import Match
from vantage.watch import HealthWatch, Verdict

VANTAGE = Path(sys.executable).parent / "vantage"


@cache
def warm_up() -> None:
    """Compile what is not compiled yet, so that starting takes as long as it does for people."""
    subprocess.run([sys.executable, "-m", "vantage.warm_up"], check=True, capture_output=True)


class Table:
    """One deployment from start to end. `started` is the outcome of `vantage up`, `took` its seconds.

    Args:
        words: more options of `vantage up`.
    """

    def __init__(self, name: str = "simulation", *words: str) -> None:
        self.words = words
        # Not pytest's folder: socket paths must be short.
        self.home = Path(tempfile.mkdtemp(prefix="vantage-test-", dir="/tmp"))
        self.folder = self.home / "run"
        self.logs = self.home / "logs"
        self.deployment = Deployment(name, self.folder)

    def __enter__(self) -> Table:
        warm_up()
        started = time.monotonic()
        self.started = self.command("up", self.deployment.name, "--logs", str(self.logs), "--timeout", "120", *self.words)
        self.took = time.monotonic() - started
        return self

    def __exit__(self, *_: object) -> None:
        self.deployment.stop()
        shutil.rmtree(self.home, ignore_errors=True)

    def command(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run `vantage` as people do, on this deployment."""
        return subprocess.run(
            [VANTAGE, *words, "--folder", str(self.folder)], capture_output=True, text=True, check=False, cwd=self.home
        )

    def services(self) -> list[str]:
        return list(self.deployment.programs)

    def pid_of(self, service: str) -> int:
        return next(process.pid for process in self.deployment.processes() if process.name == service)

    def wait_until_healthy(self, watch: HealthWatch, timeout: float, replaced: int = 0) -> float:
        """Return the seconds until every service is healthy; fails with the troubles after `timeout`.

        Args:
            replaced: a process that must be gone.
        """
        started = time.monotonic()
        while True:
            watch.listen(0.05)
            verdicts = watch.verdicts()
            sick = troubles(verdicts)
            elapsed = time.monotonic() - started
            if not sick and all(verdict.process.pid != replaced for verdict in verdicts):
                return elapsed
            assert elapsed < timeout, f"not healthy after {elapsed:.1f} s: {sick}"

    def wait_until_reported(self, watch: HealthWatch, timeout: float = 10.0) -> None:
        """Listen until every service has said how it does, well or not."""
        deadline = time.monotonic() + timeout
        while silent := [verdict.process.name for verdict in watch.verdicts() if verdict.health is None]:
            assert time.monotonic() < deadline, f"silent: {silent}"
            watch.listen(0.1)


def troubles(verdicts: list[Verdict]) -> dict[str, str]:
    return {verdict.process.name: f"{verdict.state}: {verdict.trouble}" for verdict in verdicts if not verdict.healthy}


def wish(seed: int, games: int, steps: int, period: float) -> Control:
    """Ask for games that always last `steps` steps: catches are ignored."""
    rules = Rules(maximum_steps=steps, catching=False, step_period=period)
    return Control(stamp=time.time_ns(), action="start", seed=seed, games=games, rules=rules, players=Players())


def follow(match: Match, until: Callable[[], bool], timeout: float, what: str) -> None:
    """Let a match go on until something is so."""
    deadline = time.monotonic() + timeout
    while not until():
        match.turn(0.05)
        assert time.monotonic() < deadline, f"{what}: not within {timeout:g} s (step {match.step} of {match.current})"


def stop_games(folder: Path) -> None:
    """Ask the referee to stop."""
    with ZenohBus("command-line", folder) as bus:
        deadline = time.monotonic() + 5
        while not bus.has_reader("control") and time.monotonic() < deadline:
            bus.receive(0.05)
        bus.publish("control", Control(stamp=time.time_ns(), action="stop"))
