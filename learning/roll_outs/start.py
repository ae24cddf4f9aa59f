"""Starts of games, and what the hider sees and proposes there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas import ColorImage, DepthImage, Pose, Rules
from services.planner.controller import Controller
from vantage.perception.state_image import Perceived, perceive
from vantage.world.arena import ARENA_SIZE, HIDER, SEEKER
from vantage.world.camera import Camera, render
from vantage.world.layout import boxes_array, make_layout
from vantage.world.motion import heading_radians
from vantage.world.start import draw_start


@dataclass(frozen=True)
class Start:
    """Where a game begins.

    Attributes:
        boxes: float64 [n, 7], see `vantage.world.layout.boxes_of`.
        poses: float64 [2, 3], x, y (m), heading number 0..35; row 0 the hider, row 1 the seeker.
        seed: of the episode: layout, start, camera noise, the seeker's exploration.
        catch_distance: m.
    """

    boxes: NDArray[np.float64]
    poses: NDArray[np.float64]
    seed: int
    catch_distance: float


def start_of(layout: str, seed: int, rules: Rules | None = None) -> Start:
    """Return the start of the game that the simulator sets up for this seed.

    Raises:
        ImpossibleLayout: see `vantage.world.layout.make_layout`.
    """
    rules = rules or Rules()
    boxes = boxes_array(make_layout(layout, seed))
    placed = draw_start(boxes, ARENA_SIZE, ARENA_SIZE, seed, rules.start_distance_minimum, rules.start_distance_maximum)
    return Start(boxes, np.array(placed, np.float64), seed, rules.catch_distance)


def first_view(start: Start, camera: Camera | None = None) -> Perceived:
    """Return what the hider's camera shows at step 0, as in a game of that seed."""
    camera = camera or Camera()
    depth = np.empty((camera.height, camera.width), np.uint16)
    color = np.empty((camera.height, camera.width, 3), np.uint8)
    x, y, heading = start.poses[HIDER].tolist()
    angle = heading_radians(int(heading))
    other_x, other_y, _ = start.poses[SEEKER].tolist()
    render(
        *(camera, start.boxes, ARENA_SIZE, ARENA_SIZE, x, y, angle, other_x, other_y, SEEKER, start.seed, 0, HIDER),
        depth,
        color,
    )
    size = {"width": camera.width, "height": camera.height, "intrinsics": camera.intrinsics()}
    return perceive(
        DepthImage(stamp=0, data=depth.tobytes(), **size),  # type: ignore[arg-type]
        ColorImage(stamp=0, data=color.tobytes(), **size),  # type: ignore[arg-type]
        Pose(stamp=0, x=x, y=y, heading=angle),
        "hider",
    )


def goal_paths(start: Start, steps: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the goals [G] that look free and reachable from the start, and the path planned to each [G, steps + 1, 3] (x, y in
    m, heading in rad), just as the planner proposes them at step 0.
    """
    x, y, heading = start.poses[HIDER].tolist()
    controller = Controller()
    controller.observe(first_view(start), x, y, int(heading), 0)
    paths = controller.proposals(x, y, int(heading), steps)
    return np.array(list(paths), np.int64), np.array(list(paths.values())).reshape(len(paths), steps + 1, 3)
