"""Runs stages as processes: several at a time where they leave cores free, each into its own log, and tells how it goes."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Protocol

from learning.reproduce.stages import Stage
from learning.reproduce.stamps import Stamps, file_name

POLL = 0.2  # s between looks at the processes
ENDED_WITHIN = 1.0  # s that stages have to end by themselves when all are stopped


class Process(Protocol):
    """What the runner asks of a process: that of `subprocess.Popen`."""

    def poll(self) -> int | None: ...
    def terminate(self) -> None: ...
    def kill(self) -> None: ...
    def wait(self, timeout: float | None = None) -> int: ...


Launch = Callable[[tuple[str, ...], IO[bytes], dict[str, str]], Process]


def start_process(arguments: tuple[str, ...], output: IO[bytes], environment: dict[str, str]) -> Process:
    """Start a `vantage` command as a process of the same interpreter; it ends when this one does (see `vantage.cli.main`)."""
    command = [sys.executable, "-m", "vantage.cli", *arguments]
    return subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, env=environment)


@dataclass
class Running:
    """A stage whose process is running."""

    stage: Stage
    key: str
    process: Process
    output: IO[bytes]
    log: Path
    began: float  # s, monotonic


@dataclass
class Progress:
    """How a reproduction stands, for those who show it.

    Attributes:
        stages: all, in order.
        state: of each by name: waiting, running, done, kept, taken, failed, blocked.
        running: processes.
        began: s, monotonic.
        spent: seconds of each stage that ran.
    """

    stages: list[Stage]
    slots: int
    state: dict[str, str]
    running: list[Running] = field(default_factory=list)
    began: float = field(default_factory=time.monotonic)
    spent: dict[str, float] = field(default_factory=dict)

    @property
    def finished(self) -> int:
        """How many stages need nothing more."""
        return sum(state in ("done", "kept", "taken") for state in self.state.values())

    def left(self) -> float:
        """Return the seconds that are left, roughly: as planned, times how the plan has held so far."""
        now = time.monotonic()
        ran = {running.stage.name: now - running.began for running in self.running}
        planned = sum(stage.expected for stage in self.stages if stage.name in self.spent)
        pace = min(max(sum(self.spent.values()) / planned, 0.2), 5.0) if planned > 60 else 1.0
        total = 0.0
        for stage in self.stages:
            if self.state[stage.name] in ("waiting", "running"):
                total += max(stage.expected * pace - ran.get(stage.name, 0.0), 2.0) / (1 if stage.alone else self.slots)
        return total


class Runner:
    """Runs the stages of one reproduction.

    Args:
        stages: each after those it needs.
        folder: the reproduction's.
        slots: stages that run at a time, where they are not `alone`.
        have: folders of earlier reproductions, from which products of the very same commands are taken over.
        show: called often, and whenever a stage begins or ends (then with a line about it).
        launch: starts a stage's command: the words after `vantage`, its log, its environment -> its process.
    """

    def __init__(
        self,
        stages: list[Stage],
        folder: Path,
        slots: int,
        have: tuple[Path, ...],
        show: Callable[[Progress, str], None],
        launch: Launch | None = None,
    ) -> None:
        self.stages = {stage.name: stage for stage in stages}
        self.folder, self.have, self.show, self._launch = folder, have, show, launch or start_process
        self.stamps = Stamps(folder)
        self.progress = Progress(stages, slots, {stage.name: "waiting" for stage in stages})
        self._weight = _critical_paths(stages)
        self._keys: dict[str, str] = {}  # of stages that could run: what goes in is there and does not change

    def run(self) -> bool:
        """Run what is not done yet; whether all is done then. A failed stage stops only what needs it."""
        progress = self.progress
        try:
            while True:
                self._reap()
                self._begin_what_can()
                if not progress.running:
                    break
                self.show(progress, "")
                time.sleep(POLL)
        finally:
            self._stop_all()
        return progress.finished == len(self.stages)

    def _begin_what_can(self) -> None:
        progress = self.progress
        settled = False
        while not settled:  # a kept stage may make others ready
            settled = True
            for stage in sorted(self.stages.values(), key=lambda stage: -self._weight[stage.name]):
                if progress.state[stage.name] != "waiting":
                    continue
                states = [progress.state[need] for need in stage.needs]
                if any(state in ("failed", "blocked") for state in states):
                    progress.state[stage.name] = "blocked"
                    settled = False
                    continue
                if any(state in ("waiting", "running") for state in states):
                    continue
                if stage.name not in self._keys:
                    key = self._keys[stage.name] = self.stamps.key(stage, self.stages)
                    if self.stamps.holds(stage, key):
                        progress.state[stage.name] = "kept"
                    elif any(self.stamps.take_over(stage, key, other) for other in self.have):
                        progress.state[stage.name] = "taken"
                        self.show(progress, f"{stage.name}: taken over")
                    settled = False
                elif self._free(stage):
                    self._begin(stage, self._keys[stage.name])

    def _free(self, stage: Stage) -> bool:
        running = self.progress.running
        if stage.alone or any(other.stage.alone for other in running):
            return not running
        return len(running) < self.progress.slots

    def _begin(self, stage: Stage, key: str) -> None:
        self.stamps.begin(stage, key)
        log = self.folder / "logs" / f"{file_name(stage)}.log"
        log.parent.mkdir(parents=True, exist_ok=True)
        arguments = self.arguments(stage)
        with log.open("ab") as note:
            note.write(f"$ {shlex.join(('vantage', *arguments))}\n".encode())
        output = log.open("ab")
        environment = {**os.environ, "PYTHONUNBUFFERED": "1", "COLUMNS": "130", "VANTAGE_STAGE": stage.name}
        if not stage.alone:
            environment |= {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
        process = self._launch(arguments, output, environment)
        self.progress.running.append(Running(stage, key, process, output, log, time.monotonic()))
        self.progress.state[stage.name] = "running"
        self.show(self.progress, f"{stage.name}: begins")

    def arguments(self, stage: Stage) -> tuple[str, ...]:
        """Return what follows `vantage`, with the folder filled in."""
        return tuple(self._filled(argument) for argument in (*stage.arguments, *stage.aside))

    def _filled(self, argument: str) -> str:
        return str(self.folder) + argument.removeprefix("@") if argument == "@" or argument.startswith("@/") else argument

    def _reap(self) -> None:
        progress = self.progress
        for running in list(progress.running):
            code = running.process.poll()
            if code is None:
                continue
            progress.running.remove(running)
            running.output.close()
            stage, seconds = running.stage, time.monotonic() - running.began
            missing = self.stamps.missing(stage)
            if code == 0 and not missing:
                command = shlex.join(("vantage", *self.arguments(stage)))
                self.stamps.finish(stage, running.key, command, seconds, provenance_of_stages())
                progress.state[stage.name] = "done"
                progress.spent[stage.name] = seconds
                self.show(progress, f"{stage.name}: done in {minutes(seconds)}")
                continue
            progress.state[stage.name] = "failed"
            why = f"exit code {code}" if code else f"it left no {missing[0]}"
            end = "\n".join(f"    {line}" for line in tail(running.log, 15))
            self.show(progress, f"{stage.name}: FAILED after {minutes(seconds)} ({why}). The end of {running.log}:\n{end}")

    def _stop_all(self) -> None:
        for running in self.progress.running:
            running.process.terminate()
        deadline = time.monotonic() + ENDED_WITHIN
        for running in self.progress.running:
            try:
                running.process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                running.process.kill()
                running.process.wait()
            running.output.close()
        self.progress.running.clear()


def provenance_of_stages() -> dict[str, Any]:
    """Return commit and hardware; the command is the stage's own."""
    from learning.provenance import provenance

    return {key: value for key, value in provenance().items() if key != "command"}


def _critical_paths(stages: list[Stage]) -> dict[str, float]:
    """Return for each stage the seconds of the longest chain that begins with it: those with most behind them go first."""
    weight = {stage.name: stage.expected for stage in stages}
    for stage in reversed(stages):
        for need in stage.needs:
            expected = next(other.expected for other in stages if other.name == need)
            weight[need] = max(weight[need], expected + weight[stage.name])
    return weight


def tail(log: Path, count: int) -> list[str]:
    """Return the last lines of a log that say something."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - 8192))
            text = file.read().decode(errors="replace")
    except OSError:
        return []
    return [line.rstrip() for line in text.replace("\r", "\n").split("\n") if line.strip()][-count:]


def minutes(seconds: float) -> str:
    """Return a duration as people say it."""
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
