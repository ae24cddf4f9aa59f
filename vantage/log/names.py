"""Names of the files of a log that has several parts: `RUN_000.mcap`, `RUN_001.mcap`, ..."""

from __future__ import annotations

import re
from pathlib import Path

_PART_NAME = re.compile(r"(.+)_([0-9]{3,9})", re.DOTALL)


def part_path(path: Path, number: int) -> Path:
    """Return where part `number` of the run at `path` (`RUN.mcap` or `RUN`) lies."""
    return path.with_name(f"{path.name.removesuffix('.mcap')}_{number:03d}.mcap")


def run_and_number(path: Path) -> tuple[Path, int] | None:
    """Return the run (`RUN`) and the number of a part; None for a name that no part has."""
    match = _PART_NAME.fullmatch(path.stem)
    return None if match is None else (path.with_name(match[1]), int(match[2]))
