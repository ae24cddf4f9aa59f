"""Ctrl-C in collect, convert and gather: one line, nothing half, no process left, and the same command goes on."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from learning.collect import CollectSettings, play_block
from learning.dataset import Dataset
from vantage.log import read
from vantage.log.episodes import episodes

VANTAGE = Path(sys.executable).parent / "vantage"
LIMIT = 120.0  # s, on a busy machine


def begin(*arguments: str, folder: Path) -> "subprocess.Popen[str]":
    """Start a command as a shell does: in a process group of its own, to which the terminal sends Ctrl-C."""
    files = (folder / "stdout").open("w"), (folder / "stderr").open("w")
    return subprocess.Popen([VANTAGE, *arguments], stdout=files[0], stderr=files[1], text=True, start_new_session=True)


def wait_for(state: Callable[[], bool], process: "subprocess.Popen[str]") -> None:
    deadline = time.monotonic() + LIMIT
    while not state():
        assert process.poll() is None, "it ended before it could be stopped"
        assert time.monotonic() < deadline
        time.sleep(0.002)


def stop(process: "subprocess.Popen[str]", folder: Path) -> str:
    """Press Ctrl-C; return what stands on stderr once all processes of the group are gone."""
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(LIMIT) == 130
    deadline = time.monotonic() + LIMIT
    while is_alive(process.pid):
        assert time.monotonic() < deadline, "a process outlives the command"
        time.sleep(0.01)
    return (folder / "stderr").read_text()


def is_alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def hidden(folder: Path) -> list[str]:
    return [path.name for path in folder.rglob(".*")]


COLLECT = {
    "workers import": lambda folder: "games with seeds" in (folder / "stdout").read_text(),
    "games are played": lambda folder: bool(hidden(folder / "logs")),
    "a log is finished": lambda folder: any((folder / "logs").glob("random_*.mcap")),
}


@pytest.mark.parametrize("when", COLLECT)
def test_collect(tmp_path: Path, when: str) -> None:
    command = ["collect", "--games", "60", "--hider", "random", "--block", "10", "--steps", "200", "--workers", "2"]
    command += ["--to", str(tmp_path / "logs")]
    process = begin(*command, folder=tmp_path)
    wait_for(lambda: COLLECT[when](tmp_path), process)
    errors = stop(process, tmp_path)
    assert errors == "vantage collect: stopped; finished logs are kept; the same command goes on\n"
    kept = {path.name: path.read_bytes() for path in (tmp_path / "logs").glob("[!.]*")}
    assert all(game.complete for game in episodes(read(tmp_path / "logs"))) if kept else True
    again = subprocess.run([VANTAGE, *command], capture_output=True, text=True, check=False)
    assert (again.returncode, again.stderr) == (0, "")
    assert hidden(tmp_path / "logs") == []
    assert kept.items() <= {path.name: path.read_bytes() for path in (tmp_path / "logs").iterdir()}.items()
    assert sorted(game.number for game in episodes(read(tmp_path / "logs"))) == list(range(1, 61))


def test_convert(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    settings = CollectSettings(hider="random", steps=200, catching=True)
    play_block(settings, range(1, 11), logs / "0.mcap")
    for number in range(1, 12):
        shutil.copy(logs / "0.mcap", logs / f"{number}.mcap")
    command = ["convert", str(logs), "--to", str(tmp_path / "set"), "--workers", "2"]
    process = begin(*command, folder=tmp_path)
    wait_for(lambda: any(tmp_path.glob(".set.partial-*/images.*")), process)
    errors = stop(process, tmp_path)
    assert errors == "vantage convert: stopped; nothing was written; run it again\n"
    assert not (tmp_path / "set").exists()
    again = subprocess.run([VANTAGE, *command], capture_output=True, text=True, check=False)
    assert again.returncode == 0, again.stderr
    assert hidden(tmp_path) == []
    assert len(Dataset(tmp_path / "set").episodes) == 120


def test_gather_while_it_converts(tmp_path: Path) -> None:
    command = ["gather", "--train", "30", "--validation", "2", "--test", "2", "--block", "10", "--steps", "60"]
    command += ["--workers", "2", "--to", str(tmp_path / "data")]
    process = begin(*command, folder=tmp_path)
    wait_for(lambda: any((tmp_path / "data").glob(".dataset.partial-*/images.*")), process)
    errors = stop(process, tmp_path)
    assert errors == "vantage gather: stopped; finished logs are kept; the same command goes on\n"
    assert not (tmp_path / "data" / "dataset").exists()
    again = subprocess.run([VANTAGE, *command], capture_output=True, text=True, check=False)
    assert again.returncode == 0, again.stderr
    assert hidden(tmp_path / "data") == []
    assert len(Dataset(tmp_path / "data" / "dataset").episodes) == 34
