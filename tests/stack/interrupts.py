"""Ctrl-C at random moments of every long command: `python -m tests.stack.interrupts --moments 5 --seed 1`.

Each command runs once undisturbed, then from the same beginning with an interrupt at a random moment of that time. Judged is that
it ends soon, with one line on stderr that names the command, without a traceback, without a process left behind and without
anything half under a final name; and that the same command afterwards completes. The last lines are a table; exit code 1 if
anything of this is not so. The suite tries the same in smaller pieces (test_stopping*.py, `interrupted` in
test_export_foxglove.py).
"""

from __future__ import annotations

import json
import os
import random
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import psutil
import tyro
from mcap.reader import make_reader

from tests.stack.table import VANTAGE, Table

ROOT = Path(__file__).resolve().parents[2]
GIVE_UP = 900.0
"""Seconds after which a command that should end by itself is given up."""
TERMINAL_CODES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")


@dataclass(frozen=True)
class Case:
    """A long command.

    Attributes:
        command: its words, in a folder that holds `data` (a small training set and its logs) and `cut.mcap`; FOLDER stands for
            a runtime folder, WEIGHTS for the released weights, VIEWS for those of VPT-TOB, LOG for one of the logs.
        endless: s within which it is interrupted, for a command that does not end by itself.
        on_a_table: whether FOLDER is that of a running deployment.
        afterwards: a command that ends what it has started.
    """

    command: str
    endless: float | None = None
    on_a_table: bool = False
    afterwards: str = ""

    @property
    def name(self) -> str:
        words = self.command.split()
        return " ".join(words[:2] if words[0] in ("train", "log") or words[1] == "maps" else words[:1])


CASES = (
    Case("gather --train 24 --validation 4 --test 4 --block 4 --to more"),
    Case("collect --hider goal-walk --games 60 --block 6 --to collected"),
    Case("convert data --to converted"),
    Case("log export LOG --as rerun --to exported"),
    Case("log export LOG --as lerobot --without-catching --to exported"),
    Case("log recover cut.mcap --to recovered.mcap"),
    Case("train vpt-tob --data data/dataset --preset compact --minutes 0.3 --to trained/vpt-tob.safetensors"),
    Case("train vpn --data data/dataset --views VIEWS --preset compact --minutes 0.3 --to trained/vpn.safetensors"),
    Case("train caught --data data/dataset --preset compact --minutes 0.3 --to trained/hazard.safetensors"),
    Case("evaluate --data data/dataset --weights WEIGHTS --to results/accuracy"),
    Case("evaluate maps --weights WEIGHTS --starts 2 --simulations 200 --to results/maps"),
    Case("figures --data data/dataset --weights WEIGHTS --to pictures"),
    Case("reproduce --preset smoke --to study"),
    Case("demo --to played --folder FOLDER"),
    Case("up simulation --logs recorded --folder FOLDER", afterwards="down --folder FOLDER"),
    Case("replay LOG --folder FOLDER --no-start", endless=5.0),
    Case("play --seed 7 --games 3 --steps 40 --folder FOLDER", on_a_table=True),
)


@dataclass(frozen=True)
class Settings:
    """Which commands are interrupted, and how often.

    Examples:
        python -m tests.stack.interrupts
        python -m tests.stack.interrupts --only collect convert --moments 10
    """

    only: tuple[str, ...] = ()
    """Names of commands, such as `collect` or `train vpn`; default: all."""
    moments: int = 5
    """Random moments of each."""
    seed: int = 1
    """Seed of the moments."""
    within: float = 2.0
    """Seconds within which a command has to end."""


@dataclass
class Row:
    """What became of one command.

    Attributes:
        whole: s that it takes undisturbed.
        ends: s that it took to end after each interrupt.
    """

    case: Case
    whole: float = 0.0
    ends: list[float] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)


class Stage:
    """Small data to work on, made once; each run gets a copy of its own."""

    def __init__(self) -> None:
        self.home = Path(tempfile.mkdtemp(prefix="vi-", dir="/tmp"))
        self.original = self.home / "original"
        self.original.mkdir()
        make = "gather --train 8 --validation 4 --test 4 --block 8 --to data"
        subprocess.run([VANTAGE, *make.split()], cwd=self.original, check=True, capture_output=True)
        self.log = sorted((self.original / "data").rglob("*.mcap"))[0].relative_to(self.original)
        whole = (self.original / self.log).read_bytes()
        (self.original / "cut.mcap").write_bytes(whole[: len(whole) * 2 // 3])
        self._count = 0

    def copy(self) -> Path:
        self._count += 1
        folder = self.home / str(self._count)
        shutil.copytree(self.original, folder)
        return folder

    def words(self, command: str, runtime: Path) -> list[str]:
        """Return the words of a command, with everything that stands for a path filled in."""
        paths = {"WEIGHTS": ROOT / "weights", "VIEWS": ROOT / "weights/vpt-tob.safetensors", "FOLDER": runtime, "LOG": self.log}
        return [str(paths.get(word, word)) for word in command.split()]

    def close(self) -> None:
        shutil.rmtree(self.home, ignore_errors=True)


def interrupt(settings: Settings, cases: Sequence[Case]) -> list[Row]:
    """Run each case undisturbed, then with interrupts."""
    source = random.Random(settings.seed)
    rows = []
    with ExitStack() as ending:
        stage = Stage()
        ending.callback(stage.close)
        for case in cases:
            rows.append(row := Row(case))
            with ExitStack() as around:
                runtime = around.enter_context(Table()).folder if case.on_a_table else stage.home / "run"
                if case.endless is None:
                    row.whole, trouble = complete(case, stage, stage.copy(), runtime)
                    if trouble:
                        row.violations.append(f"undisturbed: {trouble}")
                        continue
                for _ in range(settings.moments):
                    moment = source.uniform(0.0, row.whole if case.endless is None else case.endless)
                    row.violations += _interrupt_once(settings, row, stage, runtime, moment)
                    print(f"{case.name}: interrupted after {moment:.1f} s: {row.ends[-1:]}", flush=True)
    return rows


def complete(case: Case, stage: Stage, folder: Path, runtime: Path) -> tuple[float, str]:
    """Run a command to its end. Returns the seconds it took once it listens to signals, and what went wrong."""
    started = time.monotonic()
    command = [VANTAGE, *stage.words(case.command, runtime)]
    try:
        outcome = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=GIVE_UP, check=False)
    except subprocess.TimeoutExpired:
        return GIVE_UP, f"it does not end within {GIVE_UP:g} s"
    took = time.monotonic() - started
    if case.afterwards:
        subprocess.run([VANTAGE, *stage.words(case.afterwards, runtime)], cwd=folder, capture_output=True, check=False)
    return took, "" if outcome.returncode == 0 else f"exit code {outcome.returncode}: {outcome.stderr[-1000:]}"


def _interrupt_once(settings: Settings, row: Row, stage: Stage, runtime: Path, moment: float) -> list[str]:
    case, folder = row.case, stage.copy()
    at = f"after {moment:.1f} s"
    out, err = (folder.parent / f"{folder.name}.{name}" for name in ("out", "err"))
    with out.open("w") as stdout, err.open("w") as stderr:
        command = [VANTAGE, *stage.words(case.command, runtime)]
        # As in a terminal: a group of its own, all of which gets the signal.
        process = subprocess.Popen(command, cwd=folder, stdout=stdout, stderr=stderr, stdin=subprocess.DEVNULL, process_group=0)
        try:
            until = time.monotonic() + moment
            while process.poll() is None and (time.monotonic() < until or not listens(process.pid)):
                time.sleep(0.01)
            was_over = process.poll() is not None
            since = time.monotonic()
            if not was_over:
                os.killpg(process.pid, signal.SIGINT)
            try:
                process.wait(60.0)
            except subprocess.TimeoutExpired:
                return [f"{at}: it does not end"]
            took = time.monotonic() - since
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
    found = []
    printed, complained = (TERMINAL_CODES.sub("", path.read_text(errors="replace")) for path in (out, err))
    if not was_over:
        row.ends.append(took)
        lines = complained.strip().splitlines()
        if process.returncode not in (0, 130):
            found.append(f"{at}: exit code {process.returncode}")
        if took > settings.within:
            found.append(f"{at}: it ends after {took:.1f} s")
        if process.returncode and (len(lines) != 1 or not lines[0].startswith(f"vantage {case.name}: ")):
            found.append(f"{at}: it says {lines[:5]}")
    if "Traceback" in printed + complained:
        found.append(f"{at}: a traceback: {(printed + complained)[-400:]}")
    found += [f"{at}: left behind: {left}" for left in left_behind(folder, runtime, case.on_a_table)]
    found += [f"{at}: half under its final name: {path}" for path in half_written(folder)]
    if case.endless is None and process.returncode:  # else it was done before, and a result is not overwritten
        _, trouble = complete(case, stage, folder, runtime)
        if trouble:
            found.append(f"{at}: the same command again: {trouble}")
    shutil.rmtree(folder, ignore_errors=True)
    return found


def listens(pid: int) -> bool:
    """Return whether a command has come so far that it handles signals: Python itself leaves SIGHUP to the kernel."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return True
    caught = int(re.findall(r"^SigCgt:\s*([0-9a-f]+)$", status, re.MULTILINE)[0], 16)
    return bool(caught >> (signal.SIGHUP - 1) & 1)


def left_behind(folder: Path, runtime: Path, on_a_table: bool) -> list[str]:
    """Return the processes that still work in a command's folders, after they had a moment to follow it."""
    homes = {folder} if on_a_table else {folder, runtime}
    deadline = time.monotonic() + 10.0
    while True:
        left = []
        for process in psutil.process_iter():
            try:
                if Path(process.cwd()) in homes and process.status() != psutil.STATUS_ZOMBIE:
                    left.append(shlex.join(process.cmdline()[:4]))
            except psutil.Error:
                continue
        if not left or time.monotonic() > deadline:
            return left
        time.sleep(0.05)


def half_written(folder: Path) -> list[str]:
    """Return the files that are not hidden and cannot be read to their end."""
    half = []
    for path in folder.rglob("*"):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if hidden or not path.is_file() or path.name == "cut.mcap":
            continue
        try:
            read_whole(path)
        except Exception as error:
            half.append(f"{path.relative_to(folder)}: {type(error).__name__}: {error}")
    return half


def read_whole(path: Path) -> None:
    """Read a result of any kind; raises what its reader raises if it is not whole."""
    if path.suffix == ".mcap":
        with path.open("rb") as file:
            for _ in make_reader(file, validate_crcs=True).iter_messages():
                pass
    elif path.suffix == ".json":
        json.loads(path.read_text())
    elif path.suffix == ".npz":
        with zipfile.ZipFile(path) as archive:
            assert archive.testzip() is None
    elif path.suffix == ".safetensors":
        from safetensors.numpy import load_file

        load_file(path)
    elif path.suffix == ".png":
        from PIL import Image

        with Image.open(path) as picture:
            picture.load()
    elif path.suffix == ".parquet":
        from pyarrow.parquet import read_table

        read_table(path)


def table(rows: Sequence[Row]) -> str:
    lines = [f"{'':<16}{'undisturbed':>13}{'interrupts':>12}{'ended after, at most':>23}"]
    for row in rows:
        whole = f"{row.whole:.1f} s" if row.whole else ""
        most = f"{max(row.ends):.2f} s" if row.ends else ""
        lines.append(f"{row.case.name:<16}{whole:>13}{len(row.ends):>12}{most:>23}")
    violations = [f"VIOLATION {row.case.name}: {violation}" for row in rows for violation in row.violations]
    return "\n".join([*lines, *(violations or ["no violation"])])


def main(settings: Settings) -> int:
    cases = [case for case in CASES if not settings.only or case.name in settings.only]
    rows = interrupt(settings, cases)
    print(table(rows))
    return 1 if any(row.violations for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
