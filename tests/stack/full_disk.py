"""Full disks, read-only folders and folders that are deleted meanwhile: `python -m tests.stack.full_disk`.

Each command that writes much, and the recorder of a running deployment, gets a place to write to that fails it. Judged is that a
command says one line that names it and leaves nothing half under a final name, that the recorder says in its health what is
wrong as long as it is, that no message is missing unnoted, and that both go on when there is room again. The last lines are a
table; exit code 1 if anything of this is not so. As root each place is a small file system in memory; else a full disk is a
limit on the size of files, which the kernel refuses in the same way. The suite tries the same
in smaller pieces (test_full_disk.py and test_recorder.py, `a_disk_that_fails` in test_collect.py).
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from schemas import TOPICS
from tests.stack.interrupts import Stage, half_written
from tests.stack.table import PATIENCE, VANTAGE, Table, wait
from vantage.log import find_logs
from vantage.log.report import info
from vantage.watch import HealthWatch

Trouble = Literal["full", "read-only", "deleted"]
TROUBLES: tuple[Trouble, ...] = ("full", "read-only", "deleted")
IS_ROOT = os.geteuid() == 0
ENOUGH = "400m"


@dataclass(frozen=True)
class Writer:
    """A command that writes into `place`, a folder of its working folder.

    Attributes:
        room: bytes that are too few for what it writes.
    """

    name: str
    command: str
    room: int


WRITERS = (
    Writer("collect", "collect --hider goal-walk --games 60 --block 60 --to place", 400_000),
    Writer("gather", "gather --train 24 --validation 4 --test 4 --block 16 --to place", 200_000),
    Writer("convert", "convert data --to place/dataset", 200_000),
    Writer("log recover", "log recover cut.mcap --to place/recovered.mcap", 50_000),
    Writer("log export", "log export LOG --as rerun --without-catching --to place/exported", 200_000),
    Writer(
        "train caught",
        "train caught --data data/dataset --preset compact --minutes 0.3 --workspace place/work --to place/hazard.safetensors",
        100_000,
    ),
)


@dataclass(frozen=True)
class Settings:
    """What is tried.

    Examples:
        python -m tests.stack.full_disk
        python -m tests.stack.full_disk --only recorder collect
    """

    only: tuple[str, ...] = ()
    """`recorder`, or names of commands, such as `collect` or `log export`; default: all."""


@dataclass(frozen=True)
class Row:
    """What became of one writer in one trouble.

    Attributes:
        said: its line, or its health.
    """

    name: str
    trouble: Trouble
    said: str
    violations: tuple[str, ...]


class Place:
    """A folder that is full, or read-only, until `mend` makes room in it."""

    def __init__(self, path: Path, trouble: Trouble, room: int) -> None:
        self.path, self._trouble, self._room = path, trouble, room
        path.mkdir(parents=True, exist_ok=True)
        if IS_ROOT and trouble != "deleted":
            options = f"size={room}" if trouble == "full" else "ro"
            subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", path], check=True)
        elif trouble == "read-only":
            path.chmod(0o555)

    def limit(self) -> None:
        """Keep a process that is about to start from writing more than there is room for."""
        if self._trouble == "full" and not IS_ROOT:
            resource.setrlimit(resource.RLIMIT_FSIZE, (self._room, self._room))

    def mend(self) -> None:
        if IS_ROOT and self._trouble != "deleted":
            subprocess.run(["mount", "-o", f"remount,rw,size={ENOUGH}", self.path], check=True)
        elif self._trouble == "read-only":
            self.path.chmod(0o755)

    def close(self) -> None:
        if IS_ROOT and self._trouble != "deleted":
            subprocess.run(["umount", "--lazy", self.path], check=False)


@contextmanager
def troubled(path: Path, trouble: Trouble, room: int) -> Iterator[Place]:
    place = Place(path, trouble, room)
    try:
        yield place
    finally:
        place.close()


def try_command(stage: Stage, writer: Writer, trouble: Trouble) -> Row:
    """Run a command into the trouble, then again after it is mended."""
    folder = stage.copy()
    words = [VANTAGE, *stage.words(writer.command, stage.home / "run")]
    found = []
    with troubled(folder / "place", trouble, writer.room) as place:
        process = subprocess.Popen(
            words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=place.limit
        )
        if trouble == "deleted":
            until_it_writes(place.path, process)
            shutil.rmtree(place.path, ignore_errors=True)
        printed, complained = process.communicate(timeout=900)
        lines = complained.strip().splitlines()
        if "Traceback" in printed + complained:
            found.append(f"a traceback: {(printed + complained)[-500:]}")
        if process.returncode == 0:
            if trouble != "deleted":
                found.append("exit code 0, as if all had been written")
        elif len(lines) != 1 or not lines[0].startswith(f"vantage {writer.name}: "):
            found.append(f"it says {lines[:5]}")
        found += [f"half under its final name: {path}" for path in half_written(folder)]
        place.mend()
        again = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=900, check=False)
        if again.returncode:
            found.append(f"again, with room: exit code {again.returncode}: {again.stderr[-500:]}")
        elif not [path for path in place.path.rglob("*") if path.is_file()]:
            found.append("again, with room: it has written nothing")
        found += [f"again, with room: half under its final name: {path}" for path in half_written(folder)]
    shutil.rmtree(folder, ignore_errors=True)
    return Row(writer.name, trouble, lines[-1] if lines else "completed", tuple(found))


def until_it_writes(path: Path, process: subprocess.Popen[str]) -> None:
    """Wait until a process has written something, or has ended."""
    deadline = time.monotonic() + PATIENCE
    while process.poll() is None and time.monotonic() < deadline and not any(path.rglob("*")):
        time.sleep(0.01)


def try_recorder(trouble: Trouble) -> Row:
    """Play on a table whose recorder cannot write, mend that, and look at its health and at its logs."""
    found: list[str] = []
    home = Path(tempfile.mkdtemp(prefix="vf-", dir="/tmp"))
    try:
        with Table(home=home, up=False) as table:
            with troubled(table.logs, trouble, 400_000) as place:
                said = _record(table, place, trouble, found)
                table.command("down")
                found += _unseen(table.logs)
    finally:
        shutil.rmtree(home, ignore_errors=True)
    return Row("recorder", trouble, said, tuple(found))


def _record(table: Table, place: Place, trouble: Trouble, found: list[str]) -> str:
    """Return what the recorder says of the trouble."""
    started = table.up()
    if trouble == "read-only":
        if started.returncode == 0 or "recorder" not in started.stderr or "Traceback" in started.stderr:
            found.append(f"`vantage up` ends with {started.returncode} and says {started.stderr[-500:]}")
        place.mend()
        again = table.up()
        if again.returncode:
            found.append(f"with room, `vantage up` ends with {again.returncode}: {again.stderr[-500:]}")
        return "; ".join(started.stderr.strip().splitlines()[-1:])
    with HealthWatch(table.deployment) as watch:

        def recorder() -> tuple[str, str]:
            return next((verdict.state, verdict.trouble) for verdict in watch.verdicts() if verdict.process.name == "recorder")

        def play_until(state: Callable[[], bool], what: str) -> None:
            def play() -> None:
                table.command("play", "--steps", "40", "--period", "0")
                watch.listen(1.5)

            try:
                wait(state, play, lambda: what)
            except AssertionError as error:
                found.append(f"{error}: it says {recorder()}")

        if trouble == "deleted":
            play_until(lambda: any(place.path.glob("*.mcap")), "it records nothing")
            shutil.rmtree(place.path)
        play_until(lambda: recorder()[0] == "degraded", "it is not degraded")
        said = recorder()[1]
        for _ in range(3):  # as long as the trouble lasts, whatever else is written
            table.command("play", "--steps", "5", "--period", "0")
            watch.listen(1.5)
            if recorder()[0] == "ok":
                found.append("it says that all is well while nothing has changed")
        place.mend()
        place.path.mkdir(exist_ok=True)
        play_until(lambda: recorder()[0] == "ok", "it does not go on, with room")
        play_until(lambda: any(path.stat().st_size > 1000 for path in place.path.glob("*.mcap")), "it does not write again")
    return said


def _unseen(logs: Path) -> list[str]:
    """Return the messages that are missing inside logs without being noted there."""
    unseen = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for parts in find_logs(logs) if any(logs.glob("*.mcap")) else []:
            (report,) = info(parts[0])
            for (key, publisher), topic in report.topics.items():
                noted = report.gaps.get(f"{key} {publisher}", 0)
                if key in TOPICS and TOPICS[key].delivery == "lossless" and topic.missing > noted:
                    unseen.append(f"{parts[0].name}: {topic.missing} of {key} are missing, {noted} noted")
    return unseen


def try_all(settings: Settings, troubles: Sequence[Trouble] = TROUBLES) -> list[Row]:
    rows = []
    wanted = [writer for writer in WRITERS if not settings.only or writer.name in settings.only]
    if wanted:
        stage = Stage()
        try:
            for writer in wanted:
                for trouble in troubles:
                    rows.append(try_command(stage, writer, trouble))
                    print(f"{writer.name}, {trouble}: {rows[-1].said}", flush=True)
        finally:
            stage.close()
    if not settings.only or "recorder" in settings.only:
        for trouble in troubles:
            rows.append(try_recorder(trouble))
            print(f"recorder, {trouble}: {rows[-1].said}", flush=True)
    return rows


def table_of(rows: Sequence[Row]) -> str:
    lines = [f"{row.name:<14}{row.trouble:<12}{row.said[:100]}" for row in rows]
    violations = [f"VIOLATION {row.name}, {row.trouble}: {violation}" for row in rows for violation in row.violations]
    return "\n".join([*lines, *(violations or ["no violation"])])


def main(settings: Settings) -> int:
    rows = try_all(settings)
    print(table_of(rows))
    return 1 if any(row.violations for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
