"""Signals and closed terminals: trainings and reproductions end with one line, keep what is done, and leave no process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest
import torch

from learning.dataset import Dataset
from tests.learning.made_weights import play_dataset


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return play_dataset(tmp_path_factory.mktemp("stopping"))


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "vantage.cli", *arguments]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    return subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def wait_until(true: Callable[[], bool], process: subprocess.Popen[str], seconds: float = 240.0) -> None:
    deadline = time.monotonic() + seconds
    while not true():
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_training_that_is_stopped_keeps_its_checkpoint_and_goes_on(
    dataset: Dataset, tmp_path: Path, number: signal.Signals
) -> None:
    size = ("--batch", "2", "--report-every", "1000000", "--validation", "16", "--threads", "1", "--compile", "off")
    words = ("train", "caught", "--preset", "compact", "--data", str(dataset.folder), *size)
    process = start(tmp_path, *words, "--samples", "1000000")
    checkpoint = tmp_path / "runs/hazard/checkpoint.pt"
    wait_until(checkpoint.exists, process)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    (line,) = errors.splitlines()
    assert line.startswith("vantage train caught: stopped; ") and "the same command goes on" in line
    seen = torch.load(checkpoint, weights_only=True)["seen"]
    assert seen >= 2 and not list(tmp_path.rglob("*.partial*"))
    again = subprocess.run(
        [sys.executable, "-m", "vantage.cli", *words, "--samples", str(seen + 4)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert again.returncode == 0 and f"going on after {seen:,} samples" in again.stdout, again.stderr
    assert (tmp_path / "runs/hazard.safetensors").exists()


def handles(process: int, number: signal.Signals) -> bool:
    """Return whether a process has installed its own handler of a signal: that it is past its start."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return False
    caught = next(line for line in status.splitlines() if line.startswith("SigCgt:"))
    return bool(int(caught.split()[1], 16) >> (number - 1) & 1)


def is_gathering(process: psutil.Process) -> bool:
    """Return whether a process is `vantage gather`; one of it that ends meanwhile is not."""
    try:
        return "gather" in process.cmdline()
    except psutil.NoSuchProcess:
        return False


def is_alive(process: psutil.Process) -> bool:
    """Return whether a process still runs."""
    try:
        return bool(process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


@pytest.mark.timeout(600)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_the_stages_of_a_reproduction_end_with_it(tmp_path: Path, number: signal.Signals) -> None:
    process = start(tmp_path, "reproduce", "--preset", "smoke")
    here = psutil.Process(process.pid)

    def is_under_way() -> bool:
        return any(is_gathering(child) and handles(child.pid, signal.SIGTERM) for child in here.children(recursive=True))

    wait_until(is_under_way, process)
    found = here.children(recursive=True)
    assert found
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    if number == signal.SIGTERM:
        assert process.returncode == 128 + number
        assert errors == "vantage reproduce: stopped; finished stages are kept; the same command goes on\n"
    _, alive = psutil.wait_procs(found, timeout=30)
    assert not [child for child in alive if is_alive(child)]
