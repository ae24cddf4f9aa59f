"""What a robot remembers of the arena from its own views: which cells were seen free, which hold an obstacle, and when.

The grid is that of `vantage.world.search`: 48 x 48 cells of 25 mm, row along y, centred on multiples of 25 mm.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vantage.compiled import kernel
from vantage.perception.scan import NOTHING, SURFACE
from vantage.world.motion import box_distance
from vantage.world.search import CELL_SIZE, CELLS

UNKNOWN, FREE, BOUNDARY = 0, 1, 2
NEVER = -1

FREE_MARGIN = 0.020  # m by which a surface must lie behind an unknown cell's centre for the cell to count as free
CLEARED_MARGIN = 0.035  # the same for a cell marked boundary: more than half its diagonal and twice the depth noise
MEASURED = 4  # cells up to which distances to boundary cells are exact
MEASURED_DISTANCE = MEASURED * CELL_SIZE
BOX_MARGIN = 0.4 * CELL_SIZE  # m from a box within which a cell's centre makes it boundary in the privileged map


class SeenMap(NamedTuple):
    """One robot's memory.

    Attributes:
        occupancy: uint8 [48, 48], UNKNOWN, FREE or BOUNDARY.
        last_seen: int32 [48, 48], the step at which the cell was last in view, NEVER before.
    """

    occupancy: npt.NDArray[np.uint8]
    last_seen: npt.NDArray[np.int32]

    @classmethod
    def empty(cls) -> SeenMap:
        return cls(np.full((CELLS, CELLS), UNKNOWN, np.uint8), np.full((CELLS, CELLS), NEVER, np.int32))


@kernel
def observe(
    occupancy: npt.NDArray[np.uint8],
    last_seen: npt.NDArray[np.int32],
    step: int,
    ranges: npt.NDArray[np.float64],
    kinds: npt.NDArray[np.uint8],
    fx: float,
    cx: float,
    x: float,
    y: float,
    heading: float,
) -> int:
    """Add one view: mark the cells in front of the ranges of the columns about them as free, those that hold its end as boundary.

    The other robot ends a column and is never boundary; a column without return tells nothing. A cell wrongly marked
    boundary is freed when a later view sees through it.

    Args:
        occupancy, last_seen: [48, 48], changed in place.
        ranges, kinds: [W], as of `vantage.perception.scan.scan_columns` (m along the optical axis; 0, 1, 2).
        fx, cx: px.
        x, y, heading: m, m, rad, arena frame.

    Returns:
        How many cells became boundary.
    """
    width = len(ranges)
    cosine, sine = math.cos(heading), math.sin(heading)
    left_edge, right_edge = (-0.5 - cx) / fx, (width - 0.5 - cx) / fx  # sideways (right) per ahead
    farthest = 0.0
    for column in range(width):
        if kinds[column] != NOTHING and ranges[column] > farthest:
            farthest = ranges[column]
    # The box around the triangle that the camera sees.
    left_x, left_y = x + farthest * (cosine + left_edge * sine), y + farthest * (sine - left_edge * cosine)
    right_x, right_y = x + farthest * (cosine + right_edge * sine), y + farthest * (sine - right_edge * cosine)
    first_column = max(math.ceil(min(x, left_x, right_x) / CELL_SIZE), 0)
    last_column = min(math.floor(max(x, left_x, right_x) / CELL_SIZE), CELLS - 1)
    first_row = max(math.ceil(min(y, left_y, right_y) / CELL_SIZE), 0)
    last_row = min(math.floor(max(y, left_y, right_y) / CELL_SIZE), CELLS - 1)
    for row in range(first_row, last_row + 1):
        away_y = row * CELL_SIZE - y
        for cell_column in range(first_column, last_column + 1):
            away_x = cell_column * CELL_SIZE - x
            ahead = away_x * cosine + away_y * sine
            right = away_x * sine - away_y * cosine
            if ahead <= 0.0 or right <= left_edge * ahead or right >= right_edge * ahead:
                continue
            before = min(max(math.floor(cx + fx * right / ahead), 0), width - 1)
            after = min(before + 1, width - 1)
            if kinds[before] == NOTHING or kinds[after] == NOTHING:
                continue
            known = occupancy[row, cell_column]
            if ahead < min(ranges[before], ranges[after]) - (CLEARED_MARGIN if known == BOUNDARY else FREE_MARGIN):
                occupancy[row, cell_column] = FREE
                last_seen[row, cell_column] = step
    added = 0
    for column in range(width):
        if kinds[column] != SURFACE:
            continue
        ahead = ranges[column]
        right = ahead * (column - cx) / fx
        hit_column = math.floor((x + ahead * cosine + right * sine) / CELL_SIZE + 0.5)
        hit_row = math.floor((y + ahead * sine - right * cosine) / CELL_SIZE + 0.5)
        if 0 <= hit_row < CELLS and 0 <= hit_column < CELLS:
            added += occupancy[hit_row, hit_column] != BOUNDARY
            occupancy[hit_row, hit_column] = BOUNDARY
            last_seen[hit_row, hit_column] = step
    return added


@kernel
def measure(occupancy: npt.NDArray[np.uint8], squares_out: npt.NDArray[np.uint8]) -> None:
    """Squared distance, in cells, of each cell's centre to the nearest boundary cell's centre or wall: uint8 [48, 48].

    Exact up to MEASURED cells away, beyond that any greater number.
    """
    for row in range(CELLS):
        from_wall = min(row, CELLS - row)
        for column in range(CELLS):
            wall = min(from_wall, column, CELLS - column, 15)
            squares_out[row, column] = wall * wall
    for row in range(CELLS):
        for column in range(CELLS):
            if occupancy[row, column] != BOUNDARY:
                continue
            first, last = max(column - MEASURED, 0), min(column + MEASURED, CELLS - 1)
            for other in range(max(row - MEASURED, 0), min(row + MEASURED, CELLS - 1) + 1):
                rows = (other - row) * (other - row)
                for there in range(first, last + 1):
                    square = rows + (there - column) * (there - column)
                    if square < squares_out[other, there]:
                        squares_out[other, there] = square


@kernel
def too_near(clearance: float) -> float:
    """Return the squared distance in cells (see `measure`) below which a cell is nearer than `clearance` (m)."""
    return (clearance / CELL_SIZE) ** 2 - 1e-6


@kernel
def blocked(occupancy: npt.NDArray[np.uint8], clearance: float) -> npt.NDArray[np.bool_]:
    """Return bool [48, 48]: cells whose centre is nearer than `clearance` (m) to a boundary cell's centre or a wall.

    Unknown is traversable (paper: areas behind an object's boundary are free space).

    Raises:
        ValueError: the clearance is beyond what is measured.
    """
    if clearance > MEASURED_DISTANCE:
        raise ValueError("the clearance is beyond the distance that is measured")
    squares = np.empty((CELLS, CELLS), np.uint8)
    measure(occupancy, squares)
    return squares < too_near(clearance)


@kernel
def occupancy_of(boxes: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
    """Return the privileged map uint8 [48, 48] of boxes [n, 7]: boundary in and beside a box, free elsewhere."""
    occupancy = np.full((CELLS, CELLS), FREE, np.uint8)
    for row in range(CELLS):
        for column in range(CELLS):
            for index in range(len(boxes)):
                if box_distance(boxes, index, column * CELL_SIZE, row * CELL_SIZE) <= BOX_MARGIN:
                    occupancy[row, column] = BOUNDARY
    return occupancy
