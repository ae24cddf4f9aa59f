"""Compiles every kernel once, so that no service spends its first seconds on it: `python -m vantage.warm_up`.

numba keeps the machine code on disk (`vantage.compiled`), for the types a kernel was called with. So the kernels are called the
way the services call them: by playing short games in process.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from learning.collect import CollectSettings, play_block
from schemas import STATE_IMAGE_SIZE, Rules
from vantage.networks.inputs import CHANNELS, render_inputs

HIDERS = ("goal-walk", "scripted", "random")
STEPS = 25


def main() -> None:
    """Play one short game with each kind of hider and throw the log away."""
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        for hider in HIDERS:
            settings = CollectSettings(episodes=1, hider=hider, views=True, rules=Rules(maximum_steps=STEPS, catching=False))
            play_block(settings, range(1, 2), Path(folder) / f"{hider}.mcap")
    first = np.zeros(1, np.int64)
    view = np.zeros((1, STATE_IMAGE_SIZE, STATE_IMAGE_SIZE), np.uint8)
    inputs = np.empty((1, STATE_IMAGE_SIZE, STATE_IMAGE_SIZE, CHANNELS), np.uint8)
    render_inputs(view, first, np.zeros((1, 2), np.float32), first, first, first, inputs)  # what the predictor calls
    print(f"the kernels are compiled ({time.monotonic() - started:.1f} s)")


if __name__ == "__main__":
    main()
