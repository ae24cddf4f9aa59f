"""What things look like in a log that is shown.

Nothing in this room knows the arena's constants or the palette: whoever shows a log hands them over as an `Appearance`, because
the log stands on the same floor as the rooms that define them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from schemas import Robot

GOALS_A_SIDE = 11
_CELL_PIXELS = 20
_LOWEST_PICTURE = 32

Picture = NDArray[np.uint8]
Color = tuple[int, int, int]
"""Red, green, blue, each 0..255."""


@dataclass(frozen=True, slots=True)
class Appearance:
    """What things look like.

    Attributes:
        palette: uint8 [n, 3], red green blue of the state image's indices as networks see them: for data sets.
        palette_names: what each index means, n words; the last two are a robot's own disc and the other robot's.
        view_palettes: robot -> uint8 [n, 3], the same as people see them: each robot in its own colour, whoever looks.
        predicted_view: a predicted view of the seeker's in a network's colours -> the same in those that people see.
        danger: colours of a value map from no danger to the highest, in equal distances; uint8 [m, 3].
        robot_radius, robot_height: m.
        robot_colors: robot -> its colour.
        arena_size: m; of its longer side.
        blocked_color: of the goals of a value map that no path leads to.
        floor_color, box_color: of the floor and of the obstacles on it.
    """

    palette: Picture
    palette_names: tuple[str, ...]
    view_palettes: Mapping[Robot, Picture]
    predicted_view: Callable[[Picture], Picture]
    danger: Picture
    robot_radius: float
    robot_height: float
    robot_colors: Mapping[Robot, Color]
    arena_size: float
    blocked_color: Color = (128, 128, 128)
    floor_color: Color = (225, 225, 225)
    box_color: Color = (90, 90, 100)

    def view_names(self, robot: Robot) -> tuple[str, ...]:
        """Return what each index of a robot's state images means, with the names of the robots."""
        other: Robot = "seeker" if robot == "hider" else "hider"
        return (*self.palette_names[:-2], robot, other)

    def view_picture(self, indices: Picture, robot: Robot) -> Picture:
        """Return a robot's state image, palette indices [...], as people see it, uint8 [..., 3]."""
        return cast(Picture, np.take(self.view_palettes[robot], indices, axis=0, mode="clip"))


def row_repeats(height: int) -> int:
    """Return how often each row of a picture is shown: one of few rows (the one-row camera) would not be seen."""
    return -(-_LOWEST_PICTURE // height) if height < _LOWEST_PICTURE else 1


def value_picture(values: tuple[float | None, ...], goal: int | None, looks: Appearance) -> Picture:
    """Return the value map as a picture of danger, uint8 [220, 220, 3].

    The far side is at the top; the goal of the lowest danger has the first colour of `looks.danger`, that of the highest the
    last, the chosen goal a black frame.
    """
    grid = np.array([np.nan if value is None else value for value in values]).reshape(GOALS_A_SIDE, GOALS_A_SIDE)
    open_goals = ~np.isnan(grid)
    low, high = (float(grid[open_goals].min()), float(grid[open_goals].max())) if open_goals.any() else (0.0, 1.0)
    danger = np.nan_to_num((grid - low) / max(high - low, 1e-9))
    places = np.linspace(0.0, 1.0, len(looks.danger))
    picture = np.stack([np.interp(danger, places, part) for part in looks.danger.T], axis=-1).round().astype(np.uint8)
    picture[~open_goals] = looks.blocked_color
    large = np.kron(picture, np.ones((_CELL_PIXELS, _CELL_PIXELS, 1), np.uint8))
    if goal is not None:
        row, column = divmod(goal, GOALS_A_SIDE)
        cell = large[row * _CELL_PIXELS : (row + 1) * _CELL_PIXELS, column * _CELL_PIXELS : (column + 1) * _CELL_PIXELS]
        inside = cell[3:-3, 3:-3].copy()
        cell[:] = 0
        cell[3:-3, 3:-3] = inside
    return cast(Picture, np.ascontiguousarray(large[::-1]))
