"""What the arena and its robots look like in Foxglove, Lichtblick and Rerun."""

from __future__ import annotations

from schemas import Robot
from vantage.log.appearance import Appearance, Color
from vantage.perception.palette import DANGER, PALETTE, PALETTE_NAMES
from vantage.world.arena import ARENA_SIZE, HIDER_COLOR, ROBOT_HEIGHT, ROBOT_RADIUS, SEEKER_COLOR


def arena_appearance() -> Appearance:
    """Return the looks that the rest of the house uses: the state images' palette, the robots' own size and colours."""
    colors: dict[Robot, Color] = {"hider": HIDER_COLOR, "seeker": SEEKER_COLOR}
    return Appearance(PALETTE, PALETTE_NAMES, DANGER, ROBOT_RADIUS, ROBOT_HEIGHT, colors, ARENA_SIZE)
