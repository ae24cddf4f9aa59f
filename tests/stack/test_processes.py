"""Each service as a process of its own: it says how it does, stops on SIGTERM, and says in one line why it cannot start."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from vantage.bus import Sample
from vantage.bus.zenoh_bus import ZenohBus

SERVICES = ("recorder", "referee", "predictor", "simulator", "seeker", "planner")
STARTS_WITHIN = 30.0
STOPS_WITHIN = 2.0


@pytest.fixture
def folder() -> Iterator[Path]:
    path = Path(tempfile.mkdtemp(prefix="v", dir="/tmp"))
    yield path
    shutil.rmtree(path)


def start(service: str, folder: Path, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", f"services.{service}", "--folder", str(folder), *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder)


@pytest.mark.parametrize("service", SERVICES)
def test_it_reports_its_health_and_stops_on_sigterm(service: str, folder: Path) -> None:
    process = start(service, folder)
    try:
        with ZenohBus("command-line", folder) as bus:
            bus.subscribe(f"health/{service}")
            deadline = time.monotonic() + STARTS_WITHIN
            while not isinstance(bus.receive(0.2), Sample):
                assert process.poll() is None, process.communicate()[1]
                assert time.monotonic() < deadline, "no health message"
        process.send_signal(signal.SIGTERM)
        started = time.monotonic()
        _, said = process.communicate(timeout=10)
        assert time.monotonic() - started < STOPS_WITHIN
        assert process.returncode == 0, said
        assert "Traceback" not in said
    finally:
        process.kill()


@pytest.mark.parametrize(
    ("service", "options", "reason"),
    [
        ("predictor", ("--weights", "nowhere"), "no weights at"),
        ("recorder", ("--logs", "/proc/nowhere"), "/proc/nowhere"),
    ],
)
def test_it_says_in_one_line_why_it_cannot_start(service: str, options: tuple[str, ...], reason: str, folder: Path) -> None:
    process = start(service, folder, *options)
    printed, said = process.communicate(timeout=STARTS_WITHIN)
    assert process.returncode == 1
    (line,) = (printed + said).strip().splitlines()
    assert line.startswith(f"{service} cannot start: ")
    assert reason in line


def test_an_open_folder_is_refused_by_name(folder: Path) -> None:
    os.chmod(folder, 0o755)
    process = start("referee", folder)
    _, said = process.communicate(timeout=STARTS_WITHIN)
    assert process.returncode == 1
    assert f"referee cannot start: {folder} is open to other users" in said
    assert len(said.strip().splitlines()) == 1


def test_a_name_that_is_taken_is_refused(folder: Path) -> None:
    first = start("referee", folder)
    try:
        with ZenohBus("command-line", folder) as bus:
            bus.subscribe("health/referee")
            deadline = time.monotonic() + STARTS_WITHIN
            while not isinstance(bus.receive(0.2), Sample):
                assert time.monotonic() < deadline, "no health message"
            second = start("referee", folder)
            _, said = second.communicate(timeout=STARTS_WITHIN)
        assert second.returncode == 1
        assert "referee cannot start: " in said and len(said.strip().splitlines()) == 1
        assert first.poll() is None
    finally:
        first.kill()
        first.communicate()
