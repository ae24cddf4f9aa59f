"""Disks that fill up, to test with: a real one of 3 MB where mounting is allowed, else one whose writes are refused."""

from __future__ import annotations

import errno
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

SIZE = 3 << 20


class MountedDisk:
    """A file system of its own.

    Attributes:
        folder: where it is mounted.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def fill(self, leave: int = 0) -> None:
        """Use all the room but `leave` bytes."""
        with (self.folder / "ballast").open("wb", buffering=0) as ballast:
            with suppress(OSError):  # there is no more
                while True:
                    ballast.write(bytes(1 << 16))
            ballast.truncate(ballast.tell() - leave)

    def free(self) -> None:
        """Give the room back."""
        (self.folder / "ballast").unlink()

    def forbid_writing(self) -> None:
        """Make the disk read-only."""
        subprocess.run(["mount", "-o", "remount,ro", self.folder], check=True)


class RefusingDisk:
    """A folder; the system calls that write refuse, in this process, where a full disk would."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        self._room: int | None = None
        self._refusal = errno.ENOSPC
        pwritev = os.pwritev

        def write(file: int, buffers: list[bytes], offset: int) -> int:
            data = b"".join(buffers)
            if self._room is not None:
                data = data[: self._room]
                self._room -= len(data)
                if not data:
                    raise OSError(self._refusal, os.strerror(self._refusal))
            return pwritev(file, [data], offset)

        monkeypatch.setattr(os, "pwritev", write)
        monkeypatch.setattr(os, "pwrite", lambda file, data, offset: write(file, [bytes(data)], offset))

    def fill(self, leave: int = 0) -> None:
        self._room = leave

    def free(self) -> None:
        self._room = None

    def forbid_writing(self) -> None:
        self._room, self._refusal = 0, errno.EROFS


Disk = MountedDisk | RefusingDisk


@contextmanager
def small_disk(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Disk]:
    """Yield a disk of 3 MB at `folder`."""
    folder.mkdir()
    options = ["-t", "tmpfs", "-o", f"size={SIZE}", "none"]
    try:
        mounted = subprocess.run(["mount", *options, folder], capture_output=True, check=False).returncode == 0
    except OSError:
        mounted = False
    if not mounted:
        yield RefusingDisk(folder, monkeypatch)
        return
    try:
        yield MountedDisk(folder)
    finally:
        subprocess.run(["umount", "-l", folder], check=True)
