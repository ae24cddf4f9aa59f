"""The clock by which the bus tells what was published before a reader came from what was published since.

The wall clock can be set, so it orders nothing. The monotonic clock of a machine is one clock for all its processes and never
steps; it is comparable only where its identity is the same.
"""

from __future__ import annotations

import hashlib
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

IDENTITY_SIZE = 8
"""Bytes of a clock's identity."""


@dataclass(frozen=True, slots=True)
class SteadyClock:
    """A clock that never steps, and the wall clock's reading as it was when this object was made.

    Attributes:
        identity: the same in all processes whose steady times may be compared.
        now: steady time, ns.
        wall_minus_steady: ns; fixed, so that times made from it do not step either.
    """

    identity: bytes
    now: Callable[[], int] = time.monotonic_ns
    wall_minus_steady: int = field(default_factory=lambda: time.time_ns() - time.monotonic_ns())

    def wall(self) -> int:
        """Return the time, ns since the Unix epoch, as a wall clock would show it that is never set."""
        return self.now() + self.wall_minus_steady


def _machine_identity() -> bytes:
    """Return what names this machine's monotonic clock: the boot, and the time namespace, which may shift the clock."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        boot = platform.node()
    try:
        namespace = os.readlink("/proc/self/ns/time")
    except OSError:
        namespace = ""
    return hashlib.sha256(f"{boot} {namespace}".encode()).digest()[:IDENTITY_SIZE]


MACHINE = SteadyClock(_machine_identity())
"""The clock of this machine."""
