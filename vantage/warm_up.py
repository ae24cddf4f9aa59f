"""Compiles every kernel once, so that no service spends its first seconds on it: `python -m vantage.warm_up`.

numba keeps the machine code on disk (`vantage.compiled`), for the types a kernel was called with. So the kernels are called the
way the services call them: by playing short games in process.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from learning.collect import CollectSettings, play_block
from schemas import Rules

HIDERS = ("goal-walk", "scripted", "random")
STEPS = 25


def main() -> None:
    """Play one short game with each kind of hider and throw the log away."""
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        for hider in HIDERS:
            settings = CollectSettings(episodes=1, hider=hider, views=True, rules=Rules(maximum_steps=STEPS, catching=False))
            play_block(settings, range(1, 2), (), Path(folder) / f"{hider}.mcap")
    print(f"the kernels are compiled ({time.monotonic() - started:.1f} s)")


if __name__ == "__main__":
    main()
