"""How high the overhead camera hangs, and how high walls may be, for a table and a lens."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from vantage.tracking.table import TAG_CELLS, Table
from vantage.world.arena import ROBOT_RADIUS

SLACK: Final = 0.03
"""Share of the picture's half width and height that is left free at its edges."""
WALL_THICKNESS: Final = 0.012
"""m"""


@dataclass(frozen=True, slots=True)
class Mounting:
    """A camera that hangs over the middle of a table and just sees all of it.

    Attributes:
        view: horizontal angle of view, rad.
        height: of its lens above the floor, m.
        tag_pixels: width of a robot's tag under the camera, px.
        wall: the highest that leaves all corner tags in sight, m.
    """

    view: float
    height: float
    tag_pixels: float
    wall: float


def mounting(table: Table, view: float, width: int = 1280, height: int = 720) -> Mounting:
    """Return where a camera hangs, without distortion; `view` in rad, `width` and `height` of its picture in px."""
    half_across = math.tan(view / 2) * (1.0 - SLACK)
    half_along = half_across * height / width
    tag = max(table.robots.values(), key=lambda robot: robot.height)
    # Robots stand inside the walls; their tags, higher up, look farther out.
    reach = tag.size * (TAG_CELLS + 2) / TAG_CELLS / 2 - ROBOT_RADIUS
    lowest = max(
        *(abs(x) / half_across for x, _ in _corner_reaches(table)),
        *(abs(y) / half_along for _, y in _corner_reaches(table)),
        (table.width / 2 + reach) / half_across + tag.height,
        (table.depth / 2 + reach) / half_along + tag.height,
    )
    pixels = width / 2 / math.tan(view / 2) * tag.size / (lowest - tag.height)
    return Mounting(view, lowest, pixels, highest_wall(table, lowest))


def highest_wall(table: Table, height: float) -> float:
    """Return how high walls may be, m, so that a camera at a height over the middle sees every corner tag whole."""
    half = table.corner_size * (TAG_CELLS + 2) / TAG_CELLS / 2
    tallest = math.inf
    for tag in table.corners:
        across, along = abs(tag.x - table.width / 2), abs(tag.y - table.depth / 2)
        free = [(across - half, table.width / 2), (along - half, table.depth / 2)]
        # A tag beyond one wall is seen over that wall; beside a corner of the arena the better of the two does not help.
        over = [height * (near - wall - WALL_THICKNESS) / near for near, wall in free if near > wall]
        tallest = min(tallest, *(over or [0.0]))
    return max(0.0, tallest)


def _corner_reaches(table: Table) -> list[tuple[float, float]]:
    """Outermost x and y of each corner tag from the table's middle, m."""
    half = table.corner_size * (TAG_CELLS + 2) / TAG_CELLS / 2
    return [(abs(tag.x - table.width / 2) + half, abs(tag.y - table.depth / 2) + half) for tag in table.corners]
