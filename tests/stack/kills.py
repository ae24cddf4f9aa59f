"""Kill and stop services at random moments while games are played: `python -m tests.stack.kills --kills 200 --seed 1`.

Judged from outside, by status, games and logs: how long it takes until every service is healthy again, that games go on, that no
process is left behind, that every log reads and no message is missing in one that the recorder did not note. The last lines are
a table and the violations; exit code 1 if there is one. The suite runs a few kills (test_kills.py).
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import statistics
import sys
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import psutil
import tyro
from mcap.reader import make_reader

from schemas import TOPICS
from tests.stack.table import Table, troubles, wish
from vantage.bus.zenoh_bus import ZenohBus
from vantage.deployment import DeploymentError
from vantage.log import find_logs
from vantage.log.recover import recover
from vantage.log.report import info
from vantage.play import Match
from vantage.watch import HealthWatch

SUPERVISOR = "supervisord"
GIVE_UP = 120.0
"""Seconds after which the campaign no longer waits for health or for a game."""


@dataclass(frozen=True)
class Settings:
    """How much is broken, and what is allowed.

    Examples:
        python -m tests.stack.kills
        python -m tests.stack.kills --kills 20 --seed 7 --within 20
    """

    kills: int = 200
    """How many times something is killed or stopped."""
    seed: int = 1
    """Seed of whom, how and when."""
    folder: Path | None = None
    """Keep everything here (short, must not exist); default: a temporary folder that is removed."""
    within: float = 10.0
    """Seconds within which everything has to be healthy again."""
    stopped: float = 6.0
    """Seconds that a stopped process stands still."""
    minutes: float = 90.0
    """The campaign ends after this time, however many kills are left."""


@dataclass
class Fault:
    """One moment at which something is broken.

    Attributes:
        victims: service -> what is done to it.
        hurried: the next one does not wait until everything is healthy.
        healthy_after: s from the kill, or from the end of the stop, until every service was healthy again; None when the
            next fault came first.
    """

    number: int
    victims: dict[str, Literal["killed", "stopped"]]
    hurried: bool
    healthy_after: float | None = None

    def __str__(self) -> str:
        return f"fault {self.number} ({', '.join(f'{name} {what}' for name, what in self.victims.items())})"


@dataclass
class Logs:
    """What the logs hold.

    Attributes:
        noted, unseen: messages missing inside a log by the publishers' numbers: that the recorder noted, and that it did not.
    """

    count: int = 0
    messages: int = 0
    noted: int = 0
    unseen: int = 0


@dataclass
class Campaign:
    """One deployment, games without end on it, and faults. `violations` says what must not have happened."""

    settings: Settings
    table: Table
    faults: list[Fault] = field(default_factory=list)
    outcomes: Counter[str] = field(default_factory=Counter)
    violations: list[str] = field(default_factory=list)
    logs: Logs = field(default_factory=Logs)

    def __post_init__(self) -> None:
        self._source = random.Random(self.settings.seed)
        self._names = [*self.table.services(), SUPERVISOR]
        self._open()

    def run(self) -> None:
        """Break things, end the deployment, and judge what it left."""
        deadline = time.monotonic() + 60.0 * self.settings.minutes
        self._wait_until_healthy(None, time.monotonic(), {})
        self._wait_for_a_step("the first game")
        for number in range(1, self.settings.kills + 1):
            if time.monotonic() > deadline:
                break
            self.faults.append(fault := self._draw(number))
            self._break(fault)
            print(fault, "" if fault.healthy_after is None else f"healthy after {fault.healthy_after:.1f} s", flush=True)
        self._wait_until_healthy(None, time.monotonic(), {})
        self._wait_for_a_step("the last game")
        self._close()
        outcome = self.table.command("down")
        if outcome.returncode:
            self.violations.append(f"`vantage down` ends with {outcome.returncode}: {outcome.stderr}")
        self._judge_processes("the end")
        for orphan in self._processes():
            orphan.kill()
        self._judge_logs()

    def _draw(self, number: int) -> Fault:
        source = self._source
        victims = source.sample(self._names, 2 if source.random() < 0.2 else 1)
        return Fault(number, {name: source.choice(("killed", "stopped")) for name in victims}, source.random() < 0.1)

    def _break(self, fault: Fault) -> None:
        self._go_on(self._source.uniform(0.0, 3.0))
        pids = {name: pid for name, pid in self._pids().items() if name in fault.victims and pid}
        killed = {name: pid for name, pid in pids.items() if fault.victims[name] == "killed"}
        stopped = [pid for name, pid in pids.items() if fault.victims[name] == "stopped"]
        try:
            for pid in stopped:
                os.kill(pid, signal.SIGSTOP)
            for pid in killed.values():
                os.kill(pid, signal.SIGKILL)
            since = time.monotonic()
            if stopped:
                self._go_on(self.settings.stopped)
                since = time.monotonic()
        finally:
            for pid in stopped:
                with contextlib.suppress(ProcessLookupError):  # with its supervisor, a stopped service ends too
                    os.kill(pid, signal.SIGCONT)
        if SUPERVISOR in killed:
            self._up_again(fault)
        elif fault.hurried:
            self._go_on(self._source.uniform(0.2, 1.5))
            return
        self._wait_until_healthy(fault, since, killed)
        self._wait_for_a_step(str(fault))
        self._judge_processes(str(fault))

    def _up_again(self, fault: Fault) -> None:
        """Do what a person does once supervisord is dead."""
        self._close()
        outcome = self.table.up()
        if outcome.returncode:
            self.violations.append(f"{fault}: `vantage up` ends with {outcome.returncode}: {outcome.stderr[-1000:]}")
        self._open()

    def _open(self) -> None:
        self._watch = HealthWatch(self.table.deployment).__enter__()
        self._bus = ZenohBus("command-line", self.table.folder)
        self._ask()

    def _close(self) -> None:
        self._count_games()
        self._bus.close()
        self._watch.__exit__()

    def _ask(self) -> None:
        # Short games at ten steps a second; a seed of its own each time, so that no game is taken for another.
        self._match = Match(self._bus, wish(seed=self._source.randrange(1, 10**6), games=100_000, steps=60, period=0.1))

    def _count_games(self) -> None:
        self.outcomes.update(game.episode.phase for game in self._match.games)
        self._match.games.clear()

    def _turn(self) -> None:
        try:
            self._match.turn(0.02)
        except DeploymentError as error:
            self.violations.append(f"after {len(self.faults)} faults: {error}")
            self._count_games()
            self._ask()

    def _go_on(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self._turn()

    def _wait_until_healthy(self, fault: Fault | None, since: float, killed: dict[str, int]) -> None:
        while True:
            self._turn()
            self._watch.listen(0.02)
            took = time.monotonic() - since
            try:
                verdicts = self._watch.verdicts()
            except DeploymentError as error:
                trouble = str(error)
            else:
                trouble = str(troubles(verdicts)) if troubles(verdicts) else ""
                if any(verdict.process.pid in killed.values() for verdict in verdicts):
                    trouble = trouble or "it does not show that a process was killed"
            if not trouble:
                break
            if took > GIVE_UP:
                self.violations.append(f"{fault or 'the table'}: not healthy after {GIVE_UP:g} s: {trouble}")
                return
        if fault is not None:
            fault.healthy_after = took
            if took > self.settings.within:
                self.violations.append(f"{fault}: healthy after {took:.1f} s only")

    def _wait_for_a_step(self, what: str) -> None:
        """Wait until the game goes on, or another one runs."""
        self._count_games()
        game, step = (self._match.current.episode if self._match.current else 0), self._match.step
        until = time.monotonic() + GIVE_UP
        while True:
            self._turn()
            current = self._match.current
            if current is not None and self._match.step > (step if current.episode == game else 0):
                return
            if time.monotonic() > until:
                self.violations.append(f"{what}: no game goes on after {GIVE_UP:g} s: {current}")
                return

    def _pids(self) -> dict[str, int]:
        """Return the process ids of supervisord and of the services, 0 of one that has none."""
        try:
            pids = {process.name: process.pid for process in self.table.deployment.processes()}
        except DeploymentError:
            pids = {}
        supervisors = [process.pid for process in self._processes() if is_supervisor(process)]
        return {**pids, SUPERVISOR: supervisors[0] if supervisors else 0}

    def _processes(self) -> Iterator[psutil.Process]:
        """Every living process of the deployment, whoever started it."""
        for process in psutil.process_iter():
            try:
                at_home = Path(process.cwd()) == self.table.folder and process.status() != psutil.STATUS_ZOMBIE
                if at_home and (is_supervisor(process) or any(word.startswith("services.") for word in process.cmdline())):
                    yield process
            except (psutil.NoSuchProcess, psutil.AccessDenied):
                continue

    def _judge_processes(self, what: str) -> None:
        expected = {pid for pid in self._pids().values() if pid}
        orphans = {process.pid: process.cmdline()[:3] for process in self._processes() if process.pid not in expected}
        if orphans:
            self.violations.append(f"{what}: processes that nobody supervises: {orphans}")

    def _judge_logs(self) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for parts in find_logs(self.table.logs):
                (report,) = info(parts[0])
                self.logs.count += 1
                self.logs.messages += report.count
                for (key, publisher), topic in report.topics.items():
                    if key not in TOPICS or TOPICS[key].delivery != "lossless":
                        continue
                    noted = report.gaps.get(f"{key} {publisher}", 0)
                    self.logs.noted += min(noted, topic.missing)
                    if topic.missing > noted:
                        self.logs.unseen += topic.missing - noted
                        self.violations.append(f"{parts[0].name}: {topic.missing} of {key} are missing, {noted} noted")
                for part in parts:
                    self._judge_recovery(part)

    def _judge_recovery(self, part: Path) -> None:
        """Look whether a stock reader reads what our recovery makes of a log."""
        target = self.table.home / f"recovered-{part.name}"
        saved = recover(part, target).messages
        with target.open("rb") as file:
            read = sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())
        target.unlink()
        if read != saved:
            self.violations.append(f"{part.name}: recovered {saved} messages, of which the stock reader reads {read}")

    def __str__(self) -> str:
        rows = [f"{'':<28}{'times':>6}{'median':>10}{'most':>10}"]
        groups: dict[str, list[Fault]] = {"all": self.faults}
        for fault in self.faults:
            name = "two at once" if len(fault.victims) > 1 else " ".join(next(iter(fault.victims.items())))
            groups.setdefault(name, []).append(fault)
        for name, faults in sorted(groups.items(), key=lambda group: (group[0] == "all", group[0])):
            times = [fault.healthy_after for fault in faults if fault.healthy_after is not None]
            figures = f"{statistics.median(times):>8.1f} s{max(times):>8.1f} s" if times else ""
            rows.append(f"{name:<28}{len(faults):>6}{figures}")
        games = ", ".join(f"{count} {phase}" for phase, count in sorted(self.outcomes.items())) or "none"
        logs = self.logs
        rows.append(f"games: {games}")
        rows.append(
            f"logs: {logs.count}, all read; {logs.messages} messages; missing in them: {logs.noted} noted, {logs.unseen} unseen"
        )
        rows += [f"VIOLATION {violation}" for violation in self.violations] or ["no violation"]
        return "\n".join(rows)


def is_supervisor(process: psutil.Process) -> bool:
    return any("supervisor.supervisord" in word for word in process.cmdline())


def main(settings: Settings) -> int:
    with Table(home=settings.folder) as table:
        if table.started.returncode:
            print(table.started.stderr)
            return 1
        campaign = Campaign(settings, table)
        campaign.run()
    print(campaign)
    return 1 if campaign.violations else 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
