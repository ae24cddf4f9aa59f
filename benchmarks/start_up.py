"""How long starting and stopping takes: `python benchmarks/start_up.py`; `--help` shows the settings.

The test suite waits for these states; how long they take depends on what else the machine does. The goals are for two free cores.
"""

from __future__ import annotations

import resource
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import tyro

from schemas import Pose
from vantage.bus import Alive, Event, Sample
from vantage.bus.zenoh_bus import ZenohBus

VANTAGE = Path(sys.executable).parent / "vantage"
SERVICES = ("recorder", "referee", "predictor", "simulator", "seeker", "planner", "console")
GIVE_UP = 60.0
PARTICIPANT = """
import sys
from pathlib import Path
from schemas import Pose
from vantage.bus.zenoh_bus import ZenohBus
with ZenohBus("seeker", Path(sys.argv[1])) as bus:
    bus.subscribe("hider/pose")
    print("subscribed", flush=True)
    while True:
        if bus.receive(1.0) is not None:
            print("heard", flush=True)
"""


@dataclass(frozen=True)
class Settings:
    """How often to measure."""

    runs: int = 3
    """Each figure is measured this many times."""


def computing(words: list[str]) -> float:
    """Run a command; return the seconds of processor time it took."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(words, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def seconds_of(action: Callable[[], object]) -> float:
    started = time.monotonic()
    action()
    return time.monotonic() - started


@contextmanager
def private_folder() -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp(prefix="vb-", dir="/tmp"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def up_and_down() -> tuple[float, float]:
    """Return the seconds of `vantage up simulation` and of `vantage down`."""
    with private_folder() as home:
        where = ["--folder", str(home / "run")]
        up = [VANTAGE, "up", "simulation", "--logs", str(home / "logs"), *where]
        down = [VANTAGE, "down", *where]
        try:
            started = seconds_of(lambda: subprocess.run(up, check=True, capture_output=True))
            return started, seconds_of(lambda: subprocess.run(down, check=True, capture_output=True))
        finally:
            subprocess.run(down, check=False, capture_output=True)


def start_and_end(service: str) -> tuple[float, float]:
    """Return the seconds until a service alone reports its health, and from SIGTERM until it has ended."""
    with private_folder() as folder, ZenohBus("command-line", folder) as bus:
        bus.subscribe(f"health/{service}")
        words = [sys.executable, "-m", f"services.{service}", "--folder", str(folder)]
        words += ["--port", "0"] if service == "console" else []
        process = subprocess.Popen(words, stderr=subprocess.DEVNULL, cwd=folder)
        try:
            started = seconds_of(lambda: wait_for(bus, lambda event: isinstance(event, Sample)))
            process.send_signal(signal.SIGTERM)
            return started, seconds_of(lambda: process.wait(GIVE_UP))
        finally:
            process.kill()
            process.wait()


def wait_for(bus: ZenohBus, found: Callable[[Event], bool]) -> None:
    deadline = time.monotonic() + GIVE_UP
    while True:
        event = bus.receive(max(0.0, deadline - time.monotonic()))
        assert event is not None, "it did not come"
        if found(event):
            return


def kill_and_return() -> tuple[float, float]:
    """Return the seconds until a killed participant is missed, and until its successor hears what was published last."""
    with private_folder() as folder, ZenohBus("simulator", folder) as bus:
        bus.watch()
        bus.publish("hider/pose", Pose(stamp=1, x=0.1, y=0.1, heading=0.0))

        def join() -> tuple[subprocess.Popen[str], float]:
            process = subprocess.Popen([sys.executable, "-c", PARTICIPANT, str(folder)], stdout=subprocess.PIPE, text=True)
            assert process.stdout is not None
            assert process.stdout.readline() == "subscribed\n"
            took = seconds_of(process.stdout.readline)
            return process, took

        process, _ = join()
        wait_for(bus, lambda event: event == Alive("seeker", True))
        process.kill()
        missed = seconds_of(lambda: wait_for(bus, lambda event: event == Alive("seeker", False)))
        process.communicate()
        process, served = join()
        process.kill()
        process.communicate()
        return missed, served


def main(settings: Settings) -> None:
    figures: dict[str, tuple[float, list[float]]] = {}

    def note(name: str, goal: float, value: float) -> None:
        figures.setdefault(name, (goal, []))[1].append(value)

    for _ in range(settings.runs):
        note("vantage --help, computing", 0.3, computing([str(VANTAGE), "--help"]))
        up, down = up_and_down()
        note("up, until every service is healthy", 10.0, up)
        note("down", 4.0, down)
        for service in SERVICES:
            started, ended = start_and_end(service)
            note(f"{service}, until its first health", 5.0, started)
            note(f"{service}, from SIGTERM to its end", 2.0, ended)
        missed, served = kill_and_return()
        note("bus: a killed participant is missed", 1.0, missed)
        note("bus: its successor hears the latest", 1.0, served)
    print(f"{'':<40}{'median':>10}{'most':>10}{'goal':>10}")
    for name, (goal, values) in figures.items():
        print(f"{name:<40}{statistics.median(values):>8.2f} s{max(values):>8.2f} s{goal:>8.1f} s")


if __name__ == "__main__":
    main(tyro.cli(Settings))
