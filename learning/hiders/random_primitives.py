"""Random primitives: the paper's first exploration policy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from learning.hiders.open_loop import OpenLoop
from vantage.world.arena import BACKWARD, FORWARD, LEFT, RIGHT


class RandomPrimitives(OpenLoop):
    """Samples each primitive uniformly from the four that move."""

    def sequence(self, steps: int, generator: np.random.Generator) -> NDArray[np.int64]:
        return generator.choice(np.array([FORWARD, BACKWARD, LEFT, RIGHT]), size=steps)
