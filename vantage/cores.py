"""How many CPU cores this process may use."""

from __future__ import annotations

import math
import os
from pathlib import Path

_CGROUPS = Path("/sys/fs/cgroup")


def available_cores() -> int:
    """Return the cores that this process may use, at least 1.

    Counts its CPU affinity (`taskset`, a job scheduler) and the CPU quota of its control group (a container), not the cores
    that the machine has.
    """
    affinity = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota = _cpu_quota()
    return max(1, affinity if quota is None else min(affinity, math.ceil(quota)))


def _cpu_quota(cgroups: Path = _CGROUPS, process: Path = Path("/proc/self/cgroup")) -> float | None:
    """Return the smallest CPU quota of the process's control groups, cores; None without one."""
    try:
        own = [line.split(":", 2)[2].lstrip("/") for line in process.read_text().splitlines() if line.startswith("0::")]
    except (OSError, IndexError):
        own = []
    folder = cgroups / own[0] if own else cgroups
    quotas = [
        quota
        for place in (folder, *folder.parents)
        if place.is_relative_to(cgroups)
        for quota in (_quota_v2(place / "cpu.max"), _quota_v1(place / "cpu.cfs_quota_us", place / "cpu.cfs_period_us"))
        if quota is not None
    ]
    quota_v1 = _quota_v1(cgroups / "cpu/cpu.cfs_quota_us", cgroups / "cpu/cpu.cfs_period_us")
    return min([*quotas, *([] if quota_v1 is None else [quota_v1])], default=None)


def _quota_v2(file: Path) -> float | None:
    try:
        quota, period = file.read_text().split()
        return None if quota == "max" else int(quota) / int(period)
    except (OSError, ValueError, ZeroDivisionError):
        return None


def _quota_v1(quota: Path, period: Path) -> float | None:
    try:
        allowed = int(quota.read_text())
        return None if allowed <= 0 else allowed / int(period.read_text())
    except (OSError, ValueError, ZeroDivisionError):
        return None
