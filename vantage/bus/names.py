"""Names on a bus of unix sockets, known without joining it: Zenoh locks `<folder>/<name>.sock.lock` while it listens."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path


def living_names(folder: Path) -> list[str]:
    """Return the participants that are on the bus now, in any process and any container that shares the folder."""
    return sorted(lock.name.removesuffix(".sock.lock") for lock in folder.glob("*.sock.lock") if is_held(lock))


def is_held(lock: Path) -> bool:
    """Return whether a living process holds a lock file.

    It looks with a shared lock: two who look do not take each other for the holder.
    """
    try:
        descriptor = os.open(lock, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False
