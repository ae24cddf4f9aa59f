"""What a hider policy is: it sees its own camera's view and says the next primitive, and the path that it intends."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vantage.perception.state_image import Perceived


class HiderPolicy(Protocol):
    """One hider for one episode."""

    def act(self, view: Perceived, x: float, y: float, heading: int, step: int) -> int:
        """Return the primitive (number in `vantage.world.arena`) for this step.

        Args:
            view: what the hider's camera shows.
            x, y: own position, m; heading: own heading in units of 10 degrees.
        """
        ...

    def new_path(self, x: float, y: float, heading: int, step: int) -> NDArray[np.float64] | None:
        """Return the planned poses [n, 3] (x, y in m, heading in rad) of this step and each later one up to the end of the
        episode, if they differ from those returned before; else None. Called after `act`; never knows of catches.
        """
        ...
