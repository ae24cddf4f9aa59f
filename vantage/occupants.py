"""Find a deployment's processes by their working directory.

Every process of a deployment has the deployment's folder as its working directory, for as long as it lives.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

SUPERVISOR = "supervisord"
_MODULE = "services."
_POLL = 0.02


@dataclass(frozen=True, slots=True)
class Occupant:
    """A process that runs in a folder.

    Attributes:
        name: `supervisord`, or the service.
        started: clock ticks since the machine started.
    """

    name: str
    pid: int
    started: int


def occupants(folder: Path) -> list[Occupant]:
    """Return this user's supervisord and services that run in a folder, also in one that was deleted; the oldest first."""
    real = os.path.realpath(folder)
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            if entry.stat().st_uid != os.geteuid() or os.readlink(entry / "cwd") not in (real, f"{real} (deleted)"):
                continue
            name = _name_of((entry / "cmdline").read_bytes().split(b"\0"))
            started = int((entry / "stat").read_bytes().rpartition(b")")[2].split()[19])
        except OSError:
            continue  # it has ended
        if name:
            found.append(Occupant(name, int(entry.name), started))
    return sorted(found, key=lambda occupant: (occupant.started, occupant.pid))


def end(folder: Path, patience: float) -> list[Occupant]:
    """End every supervisord and service in a folder: by SIGTERM, and by SIGKILL after `patience` s. Returns what does not end."""
    for number, seconds in ((signal.SIGTERM, patience), (signal.SIGKILL, 2.0)):
        _signal(occupants(folder), number)
        if wait_until_empty(folder, seconds):
            return []
    return occupants(folder)


def wait_until_empty(folder: Path, seconds: float) -> bool:
    """Wait until no process of a deployment runs in a folder; return whether that is so."""
    deadline = time.monotonic() + seconds
    while occupants(folder):
        if time.monotonic() > deadline:
            return False
        time.sleep(_POLL)
    return True


def memory_of(pid: int) -> int:
    """Return a process's proportional share of resident memory in bytes (PSS of smaps_rollup), 0 when it is gone."""
    try:
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError):
        pass
    return 0


def _signal(found: Iterable[Occupant], number: signal.Signals) -> None:
    for occupant in found:
        with contextlib.suppress(ProcessLookupError):
            os.kill(occupant.pid, number)


def _name_of(words: list[bytes]) -> str:
    """Return `supervisord`, the service's name, or nothing, by the words of a command line."""
    for flag, module in itertools.pairwise(words):
        if flag == b"-m" and module.startswith(_MODULE.encode()):
            return os.fsdecode(module).removeprefix(_MODULE)
    if any(word == b"supervisor.supervisord" or os.path.basename(word) == b"supervisord" for word in words):
        return SUPERVISOR
    return ""
