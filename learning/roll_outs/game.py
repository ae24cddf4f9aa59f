"""Whole games in one kernel, without messages: what the ground truth of value maps and the Monte Carlo oracle are made of.

The same kernels as in play (cameras with their noise, perception, the seeker's policy, the planner's controller,
the rules), called in the same order: a roll-out with an episode's own seed is that episode, step for step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from services.planner.controller import ControllerMemory, forget_everything, head_for, next_primitive, notice
from services.seeker.policy import Attention, SeekerMemory, reset, seeker_step
from vantage.compiled import kernel
from vantage.perception.state_image import SEEN_COLUMNS, look
from vantage.world.arena import HIDER, SEEKER, STAY
from vantage.world.camera import Camera, directions
from vantage.world.game import is_caught, move_both, render_both
from vantage.world.motion import heading_radians

NO_PRIMITIVES = np.empty(0, np.int64)


class Lens(NamedTuple):
    """Both robots' camera as kernels take it; see `vantage.world.camera`."""

    rightward: NDArray[np.float64]  # [W]
    downward: NDArray[np.float64]  # [H]
    fx: float
    fy: float
    cx: float
    cy: float
    mount_height: float
    noise: bool

    @classmethod
    def of(cls, camera: Camera) -> Lens:
        pinhole = camera.intrinsics()
        return cls(
            *directions(camera), pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy, float(camera.mount_height), bool(camera.noise)
        )


class Minds(NamedTuple):
    """What both robots remember during one game; to be reused from game to game by one thread."""

    seeker: SeekerMemory
    hider: ControllerMemory

    @classmethod
    def empty(cls) -> Minds:
        return cls(SeekerMemory.empty(), ControllerMemory.empty())


@kernel
def roll_out_game(
    lens: Lens,
    boxes: NDArray[np.float64],  # [n, 7]
    width: float,
    depth: float,
    start: NDArray[np.float64],  # [2, 3] x, y (m), heading number; row 0 the hider
    goal_x: float,
    goal_y: float,
    primitives: NDArray[np.int64],  # [L]
    attention: Attention,
    catch_distance: float,
    steps: int,
    known_seed: int,
    known_until: int,
    seed: int,
    minds: Minds,
    track_out: NDArray[np.float64],  # [steps + 1, 2, 3], or no rows
) -> int:
    """Play one game; returns the step of the catch, -1 where the hider survives `steps`.

    The hider drives to (goal_x, goal_y) with the planner's controller; where the goal is NaN it plays `primitives`, then stays.
    Camera noise and the seeker's exploration come from `known_seed` up to step `known_until` (what has happened already), from
    `seed` after it. Poses of all steps played go to `track_out`, if it has rows.
    """
    reset(minds.seeker)
    forget_everything(minds.hider)
    columns, rows = len(lens.rightward), len(lens.downward)
    depths = np.empty((2, rows, columns), np.uint16)
    colors = np.empty((2, rows, columns, 3), np.uint8)
    ranges, kinds = np.empty(columns), np.empty(columns, np.uint8)
    undrawn = np.empty((0, 0), np.uint8)
    poses = start.copy()
    chosen, moved = np.empty(2, np.int64), np.empty(2, np.bool_)
    drives_to_goal = goal_x == goal_x
    for step in range(steps):
        if len(track_out):
            track_out[step] = poses
        drawn = known_seed if step <= known_until else seed
        render_both(
            lens.rightward, lens.downward, lens.mount_height, lens.noise, boxes, width, depth, poses, drawn, step, depths, colors
        )
        for robot in range(2):
            x, y, heading = poses[robot, 0], poses[robot, 1], int(poses[robot, 2])
            angle = heading_radians(heading)
            if robot == HIDER and not drives_to_goal:
                chosen[HIDER] = primitives[step] if step < len(primitives) else STAY
                continue
            seen, whole, other_x, other_y = look(
                depths[robot],
                colors[robot],
                lens.fx,
                lens.fy,
                lens.cx,
                lens.cy,
                lens.mount_height,
                1 - robot,
                x,
                y,
                angle,
                ranges,
                kinds,
                False,
                undrawn,
            )
            if robot == HIDER:
                notice(minds.hider, ranges, kinds, lens.fx, lens.cx, x, y, heading, step)
                if step == 0:
                    head_for(minds.hider, goal_x, goal_y, x, y, heading)
                chosen[HIDER] = next_primitive(minds.hider, x, y, heading)
            else:
                if seen < SEEN_COLUMNS:
                    seen, other_x, other_y = 0, 0.0, 0.0
                chosen[SEEKER] = seeker_step(
                    minds.seeker,
                    attention.look_interval,
                    attention.needs_whole,
                    attention.cuts_corners,
                    drawn,
                    step,
                    ranges,
                    kinds,
                    lens.fx,
                    lens.cx,
                    x,
                    y,
                    angle,
                    seen,
                    whole,
                    other_x,
                    other_y,
                )
        move_both(boxes, width, depth, poses, chosen, poses, moved)
        if is_caught(poses[HIDER, 0], poses[HIDER, 1], poses[SEEKER, 0], poses[SEEKER, 1], catch_distance):
            if len(track_out):
                track_out[step + 1] = poses
            return step + 1
    if len(track_out):
        track_out[steps] = poses
    return -1
