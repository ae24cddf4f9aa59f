"""What every page is told first: the arena, the palette, the bounds of what may be asked. All from the one place of each fact."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from schemas import ROBOTS
from services.console.prediction import HORIZONS
from services.console.requests import (
    GAMES_LIMIT,
    LAYOUTS,
    LONGEST_PERIOD,
    PERSON_LIMIT,
    SEEKERS,
    SHORTEST_PERIOD,
    STEPS_LIMIT,
)
from vantage.deployment import DEPLOYMENT_NAME
from vantage.perception.palette import OTHER, PALETTE, view_palette
from vantage.world import arena
from vantage.world.camera import Camera

PALETTE_NAMES = ("not visible", "free", "boundary", *ROBOTS)
"""What the colours of the hider's state images mean; each robot has one colour in every picture, whoever looks."""


def deployment_name(folder: Path) -> str:
    """Return the name of the deployment whose folder it is; empty when services were started by hand."""
    try:
        return (folder / DEPLOYMENT_NAME).read_text().strip()
    except OSError:
        return ""


def welcome(arena_name: str, deployment: str) -> dict[str, Any]:
    """Return the fields of the frame `welcome` but for the client's number. Lengths in m, angles in rad."""
    return {
        "deployment": deployment,
        "arena": arena_name,
        "size": arena.ARENA_SIZE,
        "goals": arena.GOALS.round(3).tolist(),
        "goal_spacing": arena.GOAL_SPACING,
        "robot_radius": arena.ROBOT_RADIUS,
        "catch_distance": arena.CATCH_DISTANCE,
        "field_of_view": Camera().horizontal_fov,
        "palettes": {robot: view_palette(robot).tolist() for robot in ROBOTS},
        "palette_names": PALETTE_NAMES,
        "robot_colors": arena.ROBOT_COLORS,
        "seekers": SEEKERS,
        "layouts": LAYOUTS,
        "horizons": HORIZONS,
        "limits": {
            "steps": STEPS_LIMIT,
            "games": GAMES_LIMIT,
            "person": PERSON_LIMIT,
            "period": (SHORTEST_PERIOD, LONGEST_PERIOD),
        },
    }


assert len(PALETTE_NAMES) == len(PALETTE) == OTHER + 1
