"""Each service as a process of its own: it says how it does, stops on SIGTERM, and says in one line why it cannot start."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.stack.table import PATIENCE, wait
from vantage.bus import Sample
from vantage.bus.zenoh_bus import ZenohBus

SERVICES = ("recorder", "referee", "predictor", "simulator", "seeker", "planner")


@pytest.fixture
def folder() -> Iterator[Path]:
    path = Path(tempfile.mkdtemp(prefix="v", dir="/tmp"))
    yield path
    shutil.rmtree(path)


def start(service: str, folder: Path, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", f"services.{service}", "--folder", str(folder), *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder)


def wait_for_health(folder: Path, **processes: subprocess.Popen[str]) -> None:
    """Wait until each of these services has reported its health."""
    with ZenohBus("command-line", folder) as bus:
        bus.subscribe(*(f"health/{service}" for service in processes))
        silent = set(processes)

        def listen() -> None:
            event = bus.receive(0.2)
            if isinstance(event, Sample):
                silent.discard(event.publisher)
            for service in silent:
                assert processes[service].poll() is None, processes[service].communicate()[1]

        wait(lambda: not silent, listen, lambda: f"no health message from {silent}")


def test_each_reports_its_health_and_stops_on_sigterm(folder: Path) -> None:
    """How long it takes them is measured by benchmarks/start_up.py."""
    processes = {service: start(service, folder) for service in SERVICES}
    try:
        wait_for_health(folder, **processes)
        for service, process in processes.items():
            process.send_signal(signal.SIGTERM)
            _, printed = process.communicate(timeout=PATIENCE)
            assert process.returncode == 0, f"{service}: {printed}"
            assert "Traceback" not in printed, service
    finally:
        for process in processes.values():
            process.kill()
            process.communicate()


@pytest.mark.parametrize(("service", "options", "reason"), [("predictor", ("--weights", "nowhere"), "no weights at")])
def test_it_says_in_one_line_why_it_cannot_start(service: str, options: tuple[str, ...], reason: str, folder: Path) -> None:
    process = start(service, folder, *options)
    printed, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    (line,) = (printed + said).strip().splitlines()
    assert line.startswith(f"{service} cannot start: ")
    assert reason in line


def test_an_open_folder_is_refused_by_name(folder: Path) -> None:
    os.chmod(folder, 0o755)
    process = start("referee", folder)
    _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert f"referee cannot start: {folder} is open to other users" in said
    assert len(said.strip().splitlines()) == 1


def test_a_name_that_is_taken_is_refused(folder: Path) -> None:
    first = start("referee", folder)
    try:
        wait_for_health(folder, referee=first)
        second = start("referee", folder)
        _, said = second.communicate(timeout=PATIENCE)
        assert second.returncode == 1
        assert "referee cannot start: " in said and len(said.strip().splitlines()) == 1
        assert first.poll() is None
    finally:
        first.kill()
        first.communicate()
