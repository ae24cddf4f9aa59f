"""Hiders that play a fixed sequence of primitives, whatever they see."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vantage.perception.state_image import Perceived
from vantage.world.arena import ARENA_SIZE, STAY, TURN
from vantage.world.motion import apply_primitive

_NO_BOXES = np.zeros((0, 7))


class OpenLoop:
    """Plays `sequence`; its planned path is the sequence driven in an empty arena from the present pose.

    The walls are known to everyone, the boxes are not: where a box refuses a move, the plan is drawn anew from there.
    """

    def __init__(self, maximum_steps: int, generator: np.random.Generator) -> None:
        self._primitives = self.sequence(maximum_steps, generator)  # int64 [maximum_steps]
        self._path: NDArray[np.float64] | None = None  # [maximum_steps + 1 - start, 3]
        self._path_start = 0

    def sequence(self, steps: int, generator: np.random.Generator) -> NDArray[np.int64]:
        """Return the primitives [steps] to play."""
        raise NotImplementedError

    def act(self, view: Perceived, x: float, y: float, heading: int, step: int) -> int:
        return int(self._primitives[step]) if step < len(self._primitives) else STAY

    def new_path(self, x: float, y: float, heading: int, step: int) -> NDArray[np.float64] | None:
        if self._path is not None:
            planned = self._path[step - self._path_start]
            if abs(planned[0] - x) < 1e-6 and abs(planned[1] - y) < 1e-6 and abs(planned[2] - heading * TURN) < 1e-6:
                return None
        self._path = _integrate(self._primitives[step:], x, y, heading)
        self._path_start = step
        return self._path


def _integrate(primitives: NDArray[np.int64], x: float, y: float, heading: int) -> NDArray[np.float64]:
    path = np.empty((len(primitives) + 1, 3))
    path[0] = x, y, heading * TURN
    for index, primitive in enumerate(primitives):
        x, y, heading, _ = apply_primitive(_NO_BOXES, ARENA_SIZE, ARENA_SIZE, x, y, heading, primitive, np.nan, np.nan)
        path[index + 1] = x, y, heading * TURN
    return path
