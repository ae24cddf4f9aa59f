"""The numbers of the arena and the robots: their one place.

Lengths in metres, arena frame (origin lower left, x right, y up). Inside the world a heading is an integer 0..35 in units
of 10 degrees, counter-clockwise from +x (exact comparisons; radians only on the bus).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from schemas import PRIMITIVES, Robot

ARENA_SIZE: Final = 1.2
"""Side of the square arena, m (paper, Experimental Setup)."""

ROBOT_RADIUS: Final = 0.065
"""Radius of the disc that stands for a robot, m (110 x 130 mm in the paper)."""

ROBOT_HEIGHT: Final = 0.12
MOUNT_HEIGHT: Final = 0.08
"""Optical centre of a robot's camera above the floor, m."""

WALL_HEIGHT: Final = 0.30
BOX_HEIGHT: Final = 0.20

STEP_LENGTH: Final = 0.010
"""Length of one `forward` or `backward`, m."""

HEADINGS: Final = 36
TURN: Final = math.radians(10.0)
"""Angle of one `left` or `right`, rad (10 degrees)."""

CATCH_DISTANCE: Final = 0.150
CATCH_TOLERANCE: Final = 1e-9
"""m; so that a seeker that stands at exactly the catch distance, up to rounding, has caught."""

STAY: Final = PRIMITIVES.index("stay")
FORWARD: Final = PRIMITIVES.index("forward")
BACKWARD: Final = PRIMITIVES.index("backward")
LEFT: Final = PRIMITIVES.index("left")
RIGHT: Final = PRIMITIVES.index("right")

HIDER: Final = 0
SEEKER: Final = 1
"""Row of a robot in every array over both, and its number in the camera noise."""

GOAL_COLUMNS: Final = 11
GOAL_SPACING: Final = 0.1
_goal = np.arange(GOAL_COLUMNS**2)
GOALS: Final[npt.NDArray[np.float64]] = np.stack(
    (GOAL_SPACING * (_goal % GOAL_COLUMNS + 1), GOAL_SPACING * (_goal // GOAL_COLUMNS + 1)), axis=1
)  # float64 [121, 2]: x, y of goal 11 row + column
GOALS.setflags(write=False)


def goal_name(goal: int) -> str:
    """Return what people call a goal: by its place, "goal (0.30, 1.10) m"."""
    x, y = GOALS[goal]
    return f"goal ({x:.2f}, {y:.2f}) m"


def _heading_cosines() -> npt.NDArray[np.float64]:
    """Built from one quarter turn, so that opposite and perpendicular headings are exact."""
    quarter = [math.cos(i * TURN) for i in range(HEADINGS // 4)]
    half = np.array([*quarter, 0.0, *(-c for c in reversed(quarter[1:]))])
    return np.concatenate((half, 0.0 - half))


HEADING_COSINE: Final = _heading_cosines()  # float64 [36]
HEADING_SINE: Final = np.roll(HEADING_COSINE, HEADINGS // 4)  # float64 [36]
HEADING_COSINE.setflags(write=False)
HEADING_SINE.setflags(write=False)

HIDER_COLOR: Final = (25, 190, 60)
SEEKER_COLOR: Final = (225, 40, 40)
FLOOR_COLOR: Final = (122, 120, 116)
WALL_COLOR: Final = (206, 204, 200)
BOX_COLOR: Final = (168, 160, 150)
BACKGROUND_COLOR: Final = (48, 50, 54)
"""As the cameras see them, RGB. Only robots are saturated; everything else has channels within 18 of each other."""
ROBOT_COLORS: Final[dict[Robot, tuple[int, int, int]]] = {"hider": HIDER_COLOR, "seeker": SEEKER_COLOR}
"""RGB of each robot, in camera pictures and in every picture for people."""
