"""Judging what a robot's RGB-D camera sees, as planner and seeker get it: light, holes in depth, coloured things."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from schemas import ROBOTS, Robot
from vantage.perception.scan import is_robot_color
from vantage.setting_up.annotation import ROBOT_COLORS, Canvas
from vantage.setting_up.picture_check import DARK_MEDIAN
from vantage.setting_up.verdict import Verdict

Picture = npt.NDArray[np.uint8]
Depths = npt.NDArray[np.uint16]

GREATEST_HOLES: Final = 0.4
"""Share of pixels without a depth."""
GREATEST_STRAY: Final = 0.002
"""Share of pixels of the robot's own colour, which its camera cannot see: something else has it."""
_ENLARGED: Final = 4
_FARTHEST: Final = 2000.0
"""mm; farther is drawn alike."""


def colored_pixels(color: Picture, robot: int) -> npt.NDArray[np.bool_]:
    """Return which pixels of a corrected picture uint8 [H, W, 3] the colour filter takes for a robot (0 hider, 1 seeker)."""
    rows, columns = color.shape[:2]
    taken = [is_robot_color(red, green, blue, robot) for red, green, blue in color.reshape(-1, 3).tolist()]
    return np.array(taken, dtype=bool).reshape(rows, columns)


def check_robot_view(robot: Robot, color: Picture, depth: Depths, age: float) -> tuple[list[Verdict], Picture]:
    """Judge one pair of published pictures.

    Args:
        robot: whose camera it is.
        color: corrected, uint8 [H, W, 3] RGB.
        depth: registered to it, uint16 [H, W] mm, 0 = no return.
        age: s since they were taken.

    Returns:
        The verdicts, and the pictures enlarged: colour with what is taken for a robot outlined, beside depth (near is bright,
        nothing is blue); uint8 RGB.
    """
    own = ROBOTS.index(robot)
    taken = {name: colored_pixels(color, index) for index, name in enumerate(ROBOTS)}
    shares = {name: float(mask.mean()) for name, mask in taken.items()}
    stray = shares[robot]
    other = ROBOTS[1 - own]
    holes = float((depth == 0).mean())
    lit = color[depth > 0]  # a published picture is black where there is no depth
    median = float(np.median(lit.mean(axis=1))) if len(lit) else 0.0
    when = f", {age:.0f} s ago" if age >= 2.0 else ""
    verdicts = [
        Verdict(
            f"{robot}'s camera",
            f"median {median:.0f} of 255{when}",
            "" if median >= DARK_MEDIAN else f"too dark (below {DARK_MEDIAN}): more light on the table",
        ),
        Verdict(
            f"{robot}'s depth",
            f"{100 * holes:.0f} % without depth",
            ""
            if holes <= GREATEST_HOLES
            else f"above {100 * GREATEST_HOLES:g} %: projector on, matt surfaces, no sun; nothing right before the lens",
        ),
        Verdict(
            f"{robot}'s colours",
            f"{100 * shares[other]:.1f} % taken for the {other}, {100 * stray:.1f} % for itself",
            ""
            if stray <= GREATEST_STRAY
            else f"something has the {robot}'s colour: take it away, or run `vantage table colors --robot {robot}` again",
        ),
    ]
    shown = np.kron(color, np.ones((_ENLARGED, _ENLARGED, 1), np.uint8))
    canvas = Canvas(shown)
    for name, mask in taken.items():
        if mask.any():
            large = np.kron(mask.astype(np.uint8), np.ones((_ENLARGED, _ENLARGED), np.uint8)).astype(bool)
            canvas.region(large, ROBOT_COLORS[name], f"taken for the {name}")
    canvas.words(f"{robot}'s camera", (6.0, 18.0), (255, 255, 255))
    near = np.where(depth > 0, 255.0 - 225.0 * np.minimum(depth, _FARTHEST) / _FARTHEST, 0.0).astype(np.uint8)
    grey = cv2.cvtColor(np.kron(near, np.ones((_ENLARGED, _ENLARGED), np.uint8)), cv2.COLOR_GRAY2RGB)
    grey[grey.max(axis=2) == 0] = (30, 60, 160)
    return verdicts, np.concatenate((canvas.picture, np.asarray(grey, dtype=np.uint8)), axis=1)
