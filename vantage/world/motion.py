"""Motion primitives, free space and line of sight. Compiled kernels, no state.

`boxes` is float64 [n, 7]: x, y, half_width, half_depth, cosine and sine of the heading, height (see `layout.boxes_of`).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from vantage.compiled import kernel
from vantage.world.arena import (
    BACKWARD,
    FORWARD,
    HEADING_COSINE,
    HEADING_SINE,
    HEADINGS,
    LEFT,
    MOUNT_HEIGHT,
    RIGHT,
    ROBOT_RADIUS,
    STEP_LENGTH,
    TURN,
)

Boxes = npt.NDArray[np.float64]

TOUCHING = 1e-9
"""Discs and boxes nearer than contact by less than this, m, touch and do not collide."""


@kernel
def heading_radians(heading: int) -> float:
    """Heading number (any integer) -> rad in [-pi, pi], as poses carry it on the bus."""
    angle = (heading % HEADINGS) * TURN
    return angle - 2.0 * math.pi if angle > math.pi else angle


@kernel
def heading_number(radians: float) -> int:
    """Rad -> the nearest heading number 0..35."""
    return math.floor(radians / TURN + 0.5) % HEADINGS


@kernel
def box_distance(boxes: Boxes, index: int, x: float, y: float) -> float:
    """Distance of the point (x, y) from one box, m; 0 inside."""
    offset_x = x - boxes[index, 0]
    offset_y = y - boxes[index, 1]
    cosine = boxes[index, 4]
    sine = boxes[index, 5]
    beyond_x = max(abs(cosine * offset_x + sine * offset_y) - boxes[index, 2], 0.0)
    beyond_y = max(abs(cosine * offset_y - sine * offset_x) - boxes[index, 3], 0.0)
    return math.sqrt(beyond_x * beyond_x + beyond_y * beyond_y)


@kernel
def is_free(boxes: Boxes, width: float, depth: float, x: float, y: float, radius: float) -> bool:
    """Does a disc of `radius` at (x, y) stand inside the arena without overlapping a box? Touching is free."""
    margin = radius - TOUCHING
    if not (x >= margin and y >= margin and x <= width - margin and y <= depth - margin):
        return False
    for index in range(boxes.shape[0]):  # noqa: SIM110 - all() does not compile
        if box_distance(boxes, index, x, y) < margin:
            return False
    return True


@kernel
def discs_overlap(x0: float, y0: float, x1: float, y1: float) -> bool:
    """Do two robots at these places overlap? False when either is NaN (no robot)."""
    return math.hypot(x1 - x0, y1 - y0) < 2.0 * ROBOT_RADIUS - TOUCHING


@kernel
def apply_primitive(
    boxes: Boxes,
    width: float,
    depth: float,
    x: float,
    y: float,
    heading: int,
    primitive: int,
    other_x: float,
    other_y: float,
) -> tuple[float, float, int, bool]:
    """One primitive of one robot: 10 mm along the heading, 10 degrees on the spot, or nothing.

    A move that would collide with a box, a wall or the other robot's disc (NaN: none) is refused whole.

    Returns x, y, heading 0..35, and `moved`: False exactly when the primitive was refused (so True for `stay`).
    """
    heading = int(heading) % HEADINGS
    if primitive == LEFT:
        return x, y, (heading + 1) % HEADINGS, True
    if primitive == RIGHT:
        return x, y, (heading + HEADINGS - 1) % HEADINGS, True
    if primitive == FORWARD:
        length = STEP_LENGTH
    elif primitive == BACKWARD:
        length = -STEP_LENGTH
    else:
        return x, y, heading, True
    new_x = x + length * HEADING_COSINE[heading]
    new_y = y + length * HEADING_SINE[heading]
    if discs_overlap(new_x, new_y, other_x, other_y) or not is_free(boxes, width, depth, new_x, new_y, ROBOT_RADIUS):
        return x, y, heading, False
    return new_x, new_y, heading, True


@kernel
def line_of_sight(boxes: Boxes, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Does no box stand between two points? Symmetric to the last bit.

    Boxes lower than the cameras do not block: a camera looks over them.
    """
    if x1 < x0 or (x1 == x0 and y1 < y0):
        x0, y0, x1, y1 = x1, y1, x0, y0
    for index in range(boxes.shape[0]):
        if boxes[index, 6] < MOUNT_HEIGHT:
            continue
        cosine = boxes[index, 4]
        sine = boxes[index, 5]
        offset_x = x0 - boxes[index, 0]
        offset_y = y0 - boxes[index, 1]
        start = (cosine * offset_x + sine * offset_y, cosine * offset_y - sine * offset_x)
        along = (cosine * (x1 - x0) + sine * (y1 - y0), cosine * (y1 - y0) - sine * (x1 - x0))
        half = (boxes[index, 2], boxes[index, 3])
        near = 0.0
        far = 1.0
        for axis in range(2):
            if along[axis] == 0.0:
                if abs(start[axis]) > half[axis]:
                    far = -1.0
            else:
                first = (-half[axis] - start[axis]) / along[axis]
                second = (half[axis] - start[axis]) / along[axis]
                near = max(near, min(first, second))
                far = min(far, max(first, second))
        if near <= far:
            return False
    return True
