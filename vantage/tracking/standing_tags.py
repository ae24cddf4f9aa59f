"""Tags that stand still (on boxes, on the floor): their poses averaged and held steady."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import numpy.typing as npt

from schemas import Box
from vantage.tracking.table import ObstacleTag
from vantage.tracking.tag_pose import wrapped

Floats = npt.NDArray[np.float64]

MOVED = 0.003
"""m: what moved less keeps its place."""
TURNED = math.radians(1.0)
"""rad: what turned less keeps its heading."""
ENOUGH = 3
"""Looks that agree make a place."""
_REMEMBERED = 5


class StandingTag:
    """One tag that stands still, or is carried elsewhere now and then.

    Attributes:
        held: x, y, heading float64 [3] of what carries it; None until it was seen often enough.
        last_seen: stamp of the last picture in which it was seen, ns; None before.
        settled: whether there is no need to look often: the last looks agree with what is held.
    """

    def __init__(self) -> None:
        self.held: Floats | None = None
        self.last_seen: int | None = None
        self.settled = False
        self._looks: deque[Floats] = deque(maxlen=_REMEMBERED)

    @property
    def latest(self) -> Floats | None:
        """The last pose seen, float64 [3]."""
        return self._looks[-1] if self._looks else None

    def see(self, pose: Floats, stamp: int) -> None:
        """Take one look at it: pose float64 [3], stamp in ns."""
        if self.latest is not None and differs(pose, self.latest):
            self._looks.clear()
        self._looks.append(pose)
        self.last_seen = stamp
        if len(self._looks) >= ENOUGH:
            mean = _mean(self._looks)
            if self.held is None or differs(mean, self.held):
                self.held = mean
        self.settled = self.held is not None and not any(differs(look, self.held) for look in self._looks)

    def forget(self) -> None:
        """It is gone."""
        self.held, self.settled = None, False
        self._looks.clear()


def box_at(obstacle: ObstacleTag, pose: Floats) -> Box:
    """Return a box of the table that stands at a pose, float64 [3]."""
    x, y, heading = (float(value) for value in pose)
    sides = {"half_width": obstacle.half_width, "half_depth": obstacle.half_depth, "height": obstacle.height}
    return Box(x=x, y=y, heading=heading, **sides)


def differs(pose: Floats, other: Floats) -> bool:
    """Whether two poses float64 [3] are further apart than what stands still may seem to be."""
    return math.hypot(*(pose[:2] - other[:2])) > MOVED or abs(wrapped(float(pose[2] - other[2]))) > TURNED


def _mean(poses: deque[Floats]) -> Floats:
    first = poses[0][2]
    turned = [wrapped(float(pose[2] - first)) for pose in poses]
    place = np.mean([pose[:2] for pose in poses], axis=0)
    return np.array([place[0], place[1], wrapped(float(first + np.mean(turned)))])
