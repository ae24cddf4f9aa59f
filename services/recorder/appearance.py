"""What the arena and its robots look like in Foxglove, Lichtblick and Rerun."""

from __future__ import annotations

from schemas import ROBOTS
from vantage.log.appearance import Appearance
from vantage.perception.palette import DANGER, PALETTE, PALETTE_NAMES, view_for_people, view_palette
from vantage.world.arena import ARENA_SIZE, ROBOT_COLORS, ROBOT_HEIGHT, ROBOT_RADIUS


def arena_appearance() -> Appearance:
    """Return the looks that the rest of the house uses: the state images' palettes, the robots' own size and colours."""
    return Appearance(
        palette=PALETTE,
        palette_names=PALETTE_NAMES,
        view_palettes={robot: view_palette(robot) for robot in ROBOTS},
        predicted_view=lambda view: view_for_people(view, "seeker"),
        danger=DANGER,
        robot_radius=ROBOT_RADIUS,
        robot_height=ROBOT_HEIGHT,
        robot_colors=ROBOT_COLORS,
        arena_size=ARENA_SIZE,
    )
