"""What a replay costs: opening a log, going to a moment of it, and reading on from there.

python -m benchmarks.replay LOG [LOG ...]
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from vantage.replay.recording import Recording, find_parts

MOMENTS = 50


def measure(run: Path) -> str:
    """Return a line on one log."""
    parts = find_parts(run)
    started = time.perf_counter()
    recording = Recording(*parts)
    opened = time.perf_counter() - started
    seeks = []
    for moment in np.linspace(recording.start, recording.end, MOMENTS).astype(np.int64):
        started = time.perf_counter()
        recording.latest(int(moment))
        next(recording.records(int(moment)), None)
        seeks.append(time.perf_counter() - started)
    started = time.perf_counter()
    count = sum(1 for _ in recording.records(recording.start - 1))
    read = time.perf_counter() - started
    size = sum(path.stat().st_size for path in parts) / 1e6
    duration = (recording.end - recording.start) / 1e9
    recording.close()
    return (
        f"{recording.name}: {size:.0f} MB, {duration:.0f} s, {len(recording.games)} games, {count} messages; opened in "
        f"{1e3 * opened:.0f} ms; a moment found in {1e3 * np.median(seeks):.1f} ms (median), {1e3 * max(seeks):.1f} ms (most); "
        f"read at {count / read / 1e3:.0f} k messages/s, {size / read:.0f} MB/s"
    )


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        print(measure(Path(argument)))
