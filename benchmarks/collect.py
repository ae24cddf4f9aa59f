"""How fast `vantage collect` plays and logs games, beside the same games without a log.

    python benchmarks/collect.py [--games 200] [--workers 2]

Goal: 2,000 steps a second with full logs (one-row cameras) on two cores; 10,000 would be good.
"""

from __future__ import annotations

import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import tyro

from learning.collect import CollectSettings, play_block
from vantage.log import LogWriter


@dataclass(frozen=True)
class Settings:
    """Measure the rate of data collection."""

    games: int = 200
    """Games for each side."""
    workers: int = 2
    """Processes."""
    hider: str = "goal-walk"
    """Policy of the hider."""


class NoLog(LogWriter):
    """Takes every message and writes none."""

    def write(self, key: str, payload: bytes, **_: object) -> None:
        self.message_count += 1


def play(hider: str, first: int, count: int, folder: str, logged: bool) -> int:
    """Play a block of games; returns the steps."""
    import learning.collect as collect

    collect.LogWriter = LogWriter if logged else NoLog  # type: ignore[misc]
    settings = CollectSettings(games=count, hider=hider, to=Path(folder))
    path = Path(folder) / f"{first}-{logged}.mcap"
    steps = play_block(settings, range(first, first + count), path)
    path.unlink()
    return steps


def main(settings: Settings) -> None:
    block = settings.games // settings.workers
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(settings.workers, get_context("spawn")) as pool:
        list(pool.map(play, *zip(*[(settings.hider, 1 + 2 * n, 2, folder, True) for n in range(settings.workers)], strict=True)))
        rates = {}
        for logged in (True, False):
            jobs = [(settings.hider, 1 + block * n, block, folder, logged) for n in range(settings.workers)]
            started = time.perf_counter()
            steps = sum(pool.map(play, *zip(*jobs, strict=True)))
            rates[logged] = steps / (time.perf_counter() - started)
    print(f"{settings.games} games of `{settings.hider}` with {settings.workers} workers")
    print(f"  with full logs   {rates[True]:8,.0f} steps/s")
    print(f"  without a log    {rates[False]:8,.0f} steps/s")
    print(f"  ratio            {rates[True] / rates[False]:8.2f}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
