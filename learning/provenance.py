"""Where a result comes from: it goes into the JSON of every result, so that a figure can be made again and judged."""

from __future__ import annotations

import os
import platform
import shlex
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import torch

from vantage.cores import available_cores
from vantage.log import source_commit


def provenance() -> dict[str, Any]:
    """Return what this process is: the command as typed, the commit, when, on what hardware, with which torch.

    Keys: `command`, `commit` (with `+` when the tree was edited), `when` (UTC, ISO 8601), `hardware` (see `hardware`),
    `python`, `torch`.
    """
    name = Path(sys.argv[0]).name
    return {
        "command": shlex.join(["vantage" if name == "cli.py" else name, *sys.argv[1:]]),
        "commit": source_commit(),
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
        "hardware": hardware(),
        "python": platform.python_version(),
        "torch": torch.__version__,
    }


def hardware() -> dict[str, Any]:
    """Return `cpu` (model), `cores` (that this process may use), `memory GiB` and `gpus` (names, empty without one)."""
    cores = available_cores()
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    return {
        "cpu": _cpu_model(),
        "cores": cores,
        "memory GiB": round(memory, 1),
        "gpus": [torch.cuda.get_device_name(number) for number in range(count)],
    }


def in_one_line(found: dict[str, Any]) -> str:
    """Return commit, hardware and torch of `provenance()` as people read them below a table."""
    machine = found["hardware"]
    gpus = ", ".join(machine["gpus"]) or "no GPU"
    commit = found["commit"]
    short = commit[:10] + ("+" if commit.endswith("+") else "") if commit else "unknown"
    return f"commit `{short}`, {machine['cores']} cores of {machine['cpu']}, {gpus}, torch {found['torch']}, {found['when']}"


def _cpu_model() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
