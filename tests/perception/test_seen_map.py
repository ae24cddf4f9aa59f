"""What a robot remembers: free in front, boundary at the hit, never the other robot; noise heals."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from vantage.perception.scan import scan_columns
from vantage.perception.seen_map import (
    BOUNDARY,
    BOX_MARGIN,
    FREE,
    MEASURED_DISTANCE,
    NEVER,
    UNKNOWN,
    SeenMap,
    blocked,
    observe,
    occupancy_of,
)
from vantage.world.arena import ARENA_SIZE, TURN
from vantage.world.camera import Camera, render
from vantage.world.layout import boxes_array, make_layout
from vantage.world.motion import box_distance
from vantage.world.search import CELL_SIZE, CELLS
from vantage.world.start import draw_start

CAMERA = Camera()
PINHOLE = CAMERA.intrinsics()
Floats = npt.NDArray[np.float64]


def look(
    seen: SeenMap, boxes: Floats, place: tuple[float, float, int], other: tuple[float, float], step: int, camera: Camera = CAMERA
) -> int:
    """One view with the whole chain of the camera; returns what `observe` returns."""
    x, y, heading = place
    depth, color = np.zeros((camera.height, camera.width), np.uint16), np.zeros((camera.height, camera.width, 3), np.uint8)
    render(camera, boxes, ARENA_SIZE, ARENA_SIZE, x, y, heading * TURN, *other, 0, 5, step, 1, depth, color)
    ranges, kinds = np.empty(camera.width), np.empty(camera.width, np.uint8)
    pinhole = camera.intrinsics()
    scan_columns(depth, color, pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy, pinhole.mount_height, 0, ranges, kinds)
    return int(observe(seen.occupancy, seen.last_seen, step, ranges, kinds, pinhole.fx, pinhole.cx, x, y, heading * TURN))


def nearest_surface(boxes: Floats, x: float, y: float) -> float:
    """m from a point to a box's outline (inside: 0) or a wall."""
    return min(x, y, ARENA_SIZE - x, ARENA_SIZE - y, *(box_distance(boxes, i, x, y) for i in range(len(boxes))))


NOWHERE = (math.nan, math.nan)


@pytest.mark.parametrize("seed", range(1, 9))
def test_a_turn_on_the_spot_maps_what_is_there(seed: int) -> None:
    boxes = boxes_array(make_layout("random", seed))
    (x, y, _), (other_x, other_y, _) = draw_start(boxes, ARENA_SIZE, ARENA_SIZE, seed, 0.25, 0.9)
    seen = SeenMap.empty()
    for heading in range(36):
        look(seen, boxes, (x, y, heading), (other_x, other_y), heading)
    marked = np.argwhere(seen.occupancy == BOUNDARY)
    free = np.argwhere(seen.occupancy == FREE)
    assert len(marked) > 40
    assert len(free) > 300
    for row, column in marked:
        assert nearest_surface(boxes, column * CELL_SIZE, row * CELL_SIZE) <= 0.75 * CELL_SIZE + 0.012
    for row, column in free[(free > 0).all(axis=1)]:  # row and column 0 are the walls themselves
        assert nearest_surface(boxes, column * CELL_SIZE, row * CELL_SIZE) > 0.0
    assert not (seen.occupancy[(seen.last_seen == NEVER)] != UNKNOWN).any()
    assert (seen.last_seen[seen.occupancy != UNKNOWN] >= 0).all()


def test_the_other_robot_is_never_an_obstacle_and_hides_what_is_behind() -> None:
    nothing = np.empty((0, 7))
    seen = SeenMap.empty()
    look(seen, nothing, (0.3, 0.6, 0), (0.7, 0.6), 0)
    assert not (seen.occupancy[10:38, 6:44] == BOUNDARY).any()
    assert seen.occupancy[24, 20] == FREE
    assert seen.occupancy[24, 36] == UNKNOWN
    alone = SeenMap.empty()
    look(alone, nothing, (0.3, 0.6, 0), NOWHERE, 0)
    assert alone.occupancy[24, 36] == FREE


def test_a_wrong_boundary_is_freed_when_it_is_seen_through() -> None:
    nothing = np.empty((0, 7))
    seen = SeenMap.empty()
    seen.occupancy[24, 30] = BOUNDARY
    seen.occupancy[24, 6] = BOUNDARY
    look(seen, nothing, (0.3, 0.6, 0), NOWHERE, 7)
    assert seen.occupancy[24, 30] == FREE
    assert seen.last_seen[24, 30] == 7
    assert seen.occupancy[24, 6] == BOUNDARY  # behind the camera
    assert seen.last_seen[24, 6] == NEVER


def test_a_standing_robot_does_not_flicker() -> None:
    """The same wall under camera noise: cells in the middle of a face stay boundary."""
    box = np.array([[0.8, 0.6, 0.1, 0.2, 1.0, 0.0, 0.2]])
    seen = SeenMap.empty()
    for step in range(60):
        added = look(seen, box, (0.3, 0.6, 0), NOWHERE, step)
        assert step < 30 or added <= 2
    face = seen.occupancy[20:29, 28]
    assert (face == BOUNDARY).all()


def test_columns_without_return_tell_nothing() -> None:
    seen = SeenMap.empty()
    added = observe(
        seen.occupancy, seen.last_seen, 3, np.full(128, np.nan), np.zeros(128, np.uint8), PINHOLE.fx, PINHOLE.cx, 0.6, 0.6, 1.0
    )
    assert added == 0
    assert (seen.occupancy == UNKNOWN).all()
    assert (seen.last_seen == NEVER).all()


def test_how_many_cells_became_boundary() -> None:
    seen = SeenMap.empty()
    box = np.array([[0.8, 0.6, 0.1, 0.2, 1.0, 0.0, 0.2]])
    camera = Camera(noise=False)
    assert look(seen, box, (0.3, 0.6, 0), NOWHERE, 0, camera) == (seen.occupancy == BOUNDARY).sum() > 0
    assert look(seen, box, (0.3, 0.6, 0), NOWHERE, 1, camera) == 0


@pytest.mark.parametrize("clearance", [0.0, 0.065, 0.071, 0.085, 0.1])
def test_blocked_is_what_lies_within_the_clearance(clearance: float) -> None:
    random = np.random.default_rng(1)
    occupancy = random.choice(np.array([UNKNOWN, FREE, BOUNDARY], np.uint8), (CELLS, CELLS), p=[0.5, 0.47, 0.03])
    rows, columns = np.nonzero(occupancy == BOUNDARY)
    expected = np.zeros((CELLS, CELLS), np.bool_)
    for row in range(CELLS):
        for column in range(CELLS):
            cells = np.hypot(rows - row, columns - column).min()
            wall = min(row, column, CELLS - row, CELLS - column)
            expected[row, column] = min(cells, wall) * CELL_SIZE < clearance - 1e-9
    assert (blocked(occupancy, clearance) == expected).all()


def test_a_clearance_beyond_what_is_measured_is_refused() -> None:
    with pytest.raises(ValueError, match="clearance"):
        blocked(SeenMap.empty().occupancy, MEASURED_DISTANCE + 0.01)


def test_the_privileged_map_marks_boxes_and_their_rim() -> None:
    boxes = boxes_array(make_layout("random", 3))
    occupancy = occupancy_of(boxes)
    for row in range(CELLS):
        for column in range(CELLS):
            distance = min(box_distance(boxes, i, column * CELL_SIZE, row * CELL_SIZE) for i in range(len(boxes)))
            assert (occupancy[row, column] == BOUNDARY) == (distance <= BOX_MARGIN)
    assert set(np.unique(occupancy)) == {FREE, BOUNDARY}
