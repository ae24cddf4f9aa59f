"""What ties the rehearsed table to this machine: pseudo-terminals for the robots' lines, the switches for faults, the truth."""

from __future__ import annotations

import select
import time
from pathlib import Path
from typing import IO

from services.rehearsal.core import FAULTS, PLUGS, TRUTH
from vantage.rehearsal.pseudo_terminal import PseudoTerminal
from vantage.service import DeviceLost, steady_clock

WAIT = 0.2


class Faults:
    """A file that names, one a line, what is unplugged now; no file: nothing is. Read again when it changes.

    Known are `overhead camera`, `hider camera`, `seeker camera`, `hider line` and `seeker line`.
    """

    name = FAULTS
    newest_only = False

    def __init__(self, path: Path) -> None:
        self._path = path
        self._told: frozenset[str] | None = None

    def unplugged(self) -> frozenset[str]:
        """Return what is unplugged now."""
        try:
            lines = self._path.read_text().splitlines()
        except OSError:
            return frozenset()
        return frozenset(line.strip() for line in lines) & frozenset(PLUGS)

    def open(self) -> None:
        """Nothing to open."""

    def read(self) -> tuple[frozenset[str], int] | None:
        now = self.unplugged()
        if now == self._told:
            time.sleep(WAIT / 2)
            return None
        self._told = now
        return now, steady_clock()

    def write(self, data: bytes) -> None:
        raise NotImplementedError("faults are made by people")

    def close(self) -> None:
        """Nothing to close."""


class Line:
    """The robot's end of a serial line: a pseudo-terminal with a link at `path` for the driver, gone while unplugged."""

    newest_only = False

    def __init__(self, name: str, path: Path, faults: Faults | None) -> None:
        self.name = name
        self._path, self._faults = path, faults
        self._terminal: PseudoTerminal | None = None

    def open(self) -> None:
        if self._is_unplugged():
            raise DeviceLost(f"{self.name} is unplugged")
        try:
            self._terminal = PseudoTerminal(self._path)
        except OSError as error:
            raise DeviceLost(f"{self.name}: no pseudo-terminal at {self._path}: {error}") from error

    def read(self) -> tuple[bytes, int] | None:
        assert self._terminal is not None
        if self._is_unplugged():
            raise DeviceLost(f"{self.name} is unplugged")
        ready, _, _ = select.select([self._terminal.fileno()], [], [], WAIT)
        data = self._terminal.read() if ready else b""
        return (data, steady_clock()) if data else None

    def write(self, data: bytes) -> None:
        terminal = self._terminal
        if terminal is not None and terminal.fileno() >= 0:
            terminal.write(data)

    def close(self) -> None:
        if self._terminal is not None:
            self._terminal.close()
            self._terminal = None

    def _is_unplugged(self) -> bool:
        return self._faults is not None and self.name in self._faults.unplugged()


class Truth:
    """A file of where the robots truly are, for studies of accuracy: CSV, stamp in ns, m and rad."""

    name = TRUTH
    newest_only = False
    HEADER = "stamp,hider_x,hider_y,hider_heading,seeker_x,seeker_y,seeker_heading\n"

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: IO[bytes] | None = None

    def open(self) -> None:
        try:
            self._file = self._path.open("wb")
        except OSError as error:
            raise DeviceLost(f"the truth cannot be written: {error}") from error
        self._file.write(self.HEADER.encode())

    def read(self) -> None:
        time.sleep(WAIT)

    def write(self, data: bytes) -> None:
        file = self._file
        if file is not None and not file.closed:
            file.write(data)
            file.flush()

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
