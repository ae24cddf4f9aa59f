"""The value map: which goals are safe (paper, Inference and Planning)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vantage.world.arena import GOALS

Value = Literal["expected", "binary"]


def checkpoints(horizon: int, interval: int) -> tuple[int, ...]:
    """Return the steps t = kN - 1, k = 1 .. floor(T / N), at which a catch is counted (reading of the paper, row 14)."""
    return tuple(k * interval - 1 for k in range(1, horizon // interval + 1))


def values_of(caught: NDArray[np.float32], value: Value) -> NDArray[np.float64]:
    """Return V per path, lower is safer.

    Args:
        caught: [paths, checkpoints], probability that the hider is caught by then.
        value: `binary` adds v in {0, 1} as in the paper, `expected` adds the probabilities.
    """
    counted = (caught >= 0.5) if value == "binary" else caught
    return counted.sum(axis=1, dtype=np.float64)


def choose_goal(values: NDArray[np.float64], x: float, y: float) -> int:
    """Return the index of the goal with the smallest V; ties go to the goal farthest from (x, y) (reading, row 15).

    Args:
        values: [121], NaN where blocked.

    Raises:
        ValueError: every goal is blocked.
    """
    if np.isnan(values).all():
        raise ValueError("every goal is blocked: the hider has nowhere to go")
    best = np.flatnonzero(values <= np.nanmin(values) + 1e-9)
    distances = np.hypot(GOALS[best, 0] - x, GOALS[best, 1] - y)
    return int(best[np.argmax(distances)])
