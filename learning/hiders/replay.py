"""Replay: plays the primitives of a recorded trajectory as they are, from another start (paper, Data Collection)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from learning.hiders.open_loop import OpenLoop

Trajectories = tuple[NDArray[np.int64], ...]


class Replay(OpenLoop):
    """Plays one of the recorded trajectories (int64 [steps] of primitives each), drawn at random, from its first step."""

    def __init__(self, maximum_steps: int, generator: np.random.Generator, trajectories: Trajectories) -> None:
        self._trajectories = trajectories
        super().__init__(maximum_steps, generator)

    def sequence(self, steps: int, generator: np.random.Generator) -> NDArray[np.int64]:
        recorded = self._trajectories[int(generator.integers(len(self._trajectories)))]
        sequence = np.zeros(steps, np.int64)  # STAY after the recording's end
        sequence[: min(steps, len(recorded))] = recorded[:steps]
        return sequence
