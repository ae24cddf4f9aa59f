"""Value maps that need no learning. They see what the hider sees: where the seeker stands now, and nothing of its walls."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vantage.world.arena import ARENA_SIZE, GOALS

Place = tuple[float, float]


def far_from_seeker(hider: Place, seeker: Place) -> NDArray[np.float64]:
    """Return minus the straight distance from the seeker to every goal, m. [121]"""
    return -_distances(seeker)


def nearer_to_hider(hider: Place, seeker: Place) -> NDArray[np.float64]:
    """Return the hider's distance to every goal minus the seeker's, m: by how much the seeker would be late. [121]"""
    return _distances(hider) - _distances(seeker)


HEURISTICS: dict[str, Callable[[Place, Place], NDArray[np.float64]]] = {
    "far from the seeker": far_from_seeker,
    "distance to seeker minus distance to hider": nearer_to_hider,
}
"""Name -> V per goal, its danger, from where the hider stands and where it sees the seeker."""


def seen_or_centre(seeker: Place | None) -> Place:
    """Return where the seeker is seen; a hider that does not see it takes the middle of the arena."""
    return (ARENA_SIZE / 2, ARENA_SIZE / 2) if seeker is None else seeker


def _distances(place: Place) -> NDArray[np.float64]:
    return np.hypot(GOALS[:, 0] - place[0], GOALS[:, 1] - place[1])
