"""Where the robots start: both free, in mutual line of sight, facing each other (paper, Experimental Setup)."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from vantage.compiled import kernel
from vantage.world.arena import ROBOT_RADIUS
from vantage.world.layout import ImpossibleLayout
from vantage.world.motion import discs_overlap, heading_number, is_free, line_of_sight
from vantage.world.noise import START_STREAM, uniform

ATTEMPTS = 100_000

Placed = tuple[float, float, int]
"""x, y in m, heading number 0..35."""


@kernel
def try_start(
    boxes: npt.NDArray[np.float64], width: float, depth: float, seed: int, minimum: float, maximum: float
) -> tuple[bool, float, float, int, float, float, int]:
    """Draw a start until one fits: (found, hider x, y, heading, seeker x, y, heading); distances in m."""
    for attempt in range(ATTEMPTS):
        x = width * uniform(seed, START_STREAM, attempt, 0)
        y = depth * uniform(seed, START_STREAM, attempt, 1)
        if not is_free(boxes, width, depth, x, y, ROBOT_RADIUS):
            continue
        angle = 2.0 * math.pi * uniform(seed, START_STREAM, attempt, 2)
        distance = minimum + (maximum - minimum) * uniform(seed, START_STREAM, attempt, 3)
        other_x = x + distance * math.cos(angle)
        other_y = y + distance * math.sin(angle)
        if (
            is_free(boxes, width, depth, other_x, other_y, ROBOT_RADIUS)
            and not discs_overlap(x, y, other_x, other_y)
            and line_of_sight(boxes, x, y, other_x, other_y)
        ):
            facing = heading_number(angle)
            return True, x, y, facing, other_x, other_y, heading_number(angle + math.pi)
    return False, 0.0, 0.0, 0, 0.0, 0.0, 0


def draw_start(
    boxes: npt.NDArray[np.float64], width: float, depth: float, seed: int, minimum: float, maximum: float
) -> tuple[Placed, Placed]:
    """Start of hider and seeker for a seed.

    Both discs free, in mutual line of sight, their centres `minimum` to `maximum` m apart, facing each other to the
    nearest 10 degrees. Raises `ImpossibleLayout` when no such pair is found.
    """
    found, hider_x, hider_y, hider_heading, seeker_x, seeker_y, seeker_heading = try_start(
        boxes, float(width), float(depth), int(seed), float(minimum), float(maximum)
    )
    if not found:
        raise ImpossibleLayout(
            f"found no start: two robots in sight of each other, {minimum:g} to {maximum:g} m apart, do not fit between "
            f"{len(boxes)} obstacles in {width:g} x {depth:g} m; take obstacles away or change the start distances"
        )
    return (hider_x, hider_y, hider_heading), (seeker_x, seeker_y, seeker_heading)
