"""The rules of the game as kernels: both robots' motions, the catch, and a whole step with both cameras.

Poses of both robots are float64 [2, 3]: x, y (m), heading number; row 0 the hider, row 1 the seeker.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from vantage.compiled import kernel
from vantage.world.arena import CATCH_TOLERANCE, HIDER, SEEKER
from vantage.world.camera import render_picture
from vantage.world.motion import apply_primitive, discs_overlap, heading_radians

Floats = npt.NDArray[np.float64]


@kernel
def move_both(
    boxes: Floats,
    width: float,
    depth: float,
    poses: Floats,
    primitives: npt.NDArray[np.int64],
    poses_out: Floats,
    moved_out: npt.NDArray[np.bool_],
) -> None:
    """Carry out both robots' primitives (int64 [2]) of one step at the same time.

    Each is judged against the other robot's old place; when both are allowed but would end overlapping, both are
    refused. So the result does not depend on an order, and robots that do not overlap never come to.

    Writes float64 [2, 3] (may be `poses` itself) and bool [2]: False exactly where a primitive was refused.
    """
    hider_x, hider_y = poses[HIDER, 0], poses[HIDER, 1]
    seeker_x, seeker_y = poses[SEEKER, 0], poses[SEEKER, 1]
    new_hider_x, new_hider_y, hider_heading, hider_moved = apply_primitive(
        boxes, width, depth, hider_x, hider_y, int(poses[HIDER, 2]), primitives[HIDER], seeker_x, seeker_y
    )
    new_seeker_x, new_seeker_y, seeker_heading, seeker_moved = apply_primitive(
        boxes, width, depth, seeker_x, seeker_y, int(poses[SEEKER, 2]), primitives[SEEKER], hider_x, hider_y
    )
    hider_travels = new_hider_x != hider_x or new_hider_y != hider_y
    seeker_travels = new_seeker_x != seeker_x or new_seeker_y != seeker_y
    if hider_travels and seeker_travels and discs_overlap(new_hider_x, new_hider_y, new_seeker_x, new_seeker_y):
        new_hider_x, new_hider_y, hider_moved = hider_x, hider_y, False
        new_seeker_x, new_seeker_y, seeker_moved = seeker_x, seeker_y, False
    poses_out[HIDER, 0], poses_out[HIDER, 1], poses_out[HIDER, 2] = new_hider_x, new_hider_y, hider_heading
    poses_out[SEEKER, 0], poses_out[SEEKER, 1], poses_out[SEEKER, 2] = new_seeker_x, new_seeker_y, seeker_heading
    moved_out[HIDER] = hider_moved
    moved_out[SEEKER] = seeker_moved


@kernel
def is_caught(hider_x: float, hider_y: float, seeker_x: float, seeker_y: float, catch_distance: float) -> bool:
    """Are the robots' centres at or nearer than `catch_distance` (all in m)?"""
    return math.hypot(seeker_x - hider_x, seeker_y - hider_y) <= catch_distance + CATCH_TOLERANCE


@kernel
def render_both(
    rightward: Floats,
    downward: Floats,
    mount_height: float,
    noise: bool,
    boxes: Floats,
    width: float,
    depth: float,
    poses: Floats,
    seed: int,
    step: int,
    depths_out: npt.NDArray[np.uint16],
    colors_out: npt.NDArray[np.uint8],
) -> None:
    """Both robots' pictures: depth uint16 [2, H, W] (mm, 0 = no return) and colour uint8 [2, H, W, 3].

    `rightward` float64 [W] and `downward` float64 [H] are the camera's `directions`.
    """
    for robot in range(2):
        other = 1 - robot
        render_picture(
            rightward,
            downward,
            mount_height,
            noise,
            boxes,
            width,
            depth,
            poses[robot, 0],
            poses[robot, 1],
            heading_radians(int(poses[robot, 2])),
            poses[other, 0],
            poses[other, 1],
            other,
            seed,
            step,
            robot,
            depths_out[robot],
            colors_out[robot],
        )


@kernel
def step_game(
    rightward: Floats,
    downward: Floats,
    mount_height: float,
    noise: bool,
    boxes: Floats,
    width: float,
    depth: float,
    poses: Floats,
    primitives: npt.NDArray[np.int64],
    catch_distance: float,
    seed: int,
    step: int,
    poses_out: Floats,
    moved_out: npt.NDArray[np.bool_],
    depths_out: npt.NDArray[np.uint16],
    colors_out: npt.NDArray[np.uint8],
) -> bool:
    """One whole step: both motions, both pictures of the new step number `step`, the catch test.

    Arguments as in `move_both` and `render_both`. Returns whether the hider is caught at the new poses.
    """
    move_both(boxes, width, depth, poses, primitives, poses_out, moved_out)
    render_both(rightward, downward, mount_height, noise, boxes, width, depth, poses_out, seed, step, depths_out, colors_out)
    return is_caught(poses_out[HIDER, 0], poses_out[HIDER, 1], poses_out[SEEKER, 0], poses_out[SEEKER, 1], catch_distance)
