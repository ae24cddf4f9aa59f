"""Free space, primitives and line of sight against sampled outlines, and their symmetries."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.world import reference
from vantage.world import arena
from vantage.world.layout import boxes_array, make_layout
from vantage.world.motion import (
    apply_primitive,
    box_distance,
    heading_number,
    heading_radians,
    is_free,
    line_of_sight,
)

SIZE = arena.ARENA_SIZE
NO_BOXES = np.empty((0, 7))
NO_OTHER = (math.nan, math.nan)
seeds = st.integers(0, 2**40)
coordinates = st.floats(-0.1, 1.3)
headings = st.integers(0, 35)
primitives = st.integers(0, 4)


def sampled_distance(box: reference.Floats, x: float, y: float) -> float:
    """Distance from a box, from points on its outline 0.3 to 1.2 mm apart: at most 0.6 mm too large."""
    if reference.inside(box, np.array([x, y])):
        return 0.0
    return float(np.hypot(*(reference.outline(box) - (x, y)).T).min())


@given(seed=seeds, x=coordinates, y=coordinates)
@settings(max_examples=150, deadline=None)
def test_distance_and_free_space_agree_with_sampled_outlines(seed: int, x: float, y: float) -> None:
    boxes = boxes_array(make_layout("random", seed))
    sampled = [sampled_distance(box, x, y) for box in boxes]
    for index, expected in enumerate(sampled):
        assert expected - 6e-4 <= box_distance(boxes, index, x, y) <= expected + 1e-12
    clearance = min(*sampled, x, y, SIZE - x, SIZE - y)
    assume(abs(clearance - arena.ROBOT_RADIUS) > 1e-3)
    assert is_free(boxes, SIZE, SIZE, x, y, arena.ROBOT_RADIUS) == (clearance > arena.ROBOT_RADIUS)


def test_touching_is_free_and_nowhere_is_not() -> None:
    box = np.array([[0.6, 0.6, 0.1, 0.1, 1.0, 0.0, 0.2]])
    radius = arena.ROBOT_RADIUS
    assert is_free(box, SIZE, SIZE, 0.5 - radius, 0.6, radius)
    assert not is_free(box, SIZE, SIZE, 0.5 - radius + 1e-6, 0.6, radius)
    assert is_free(box, SIZE, SIZE, radius, SIZE - radius, radius)
    assert not is_free(box, SIZE, SIZE, radius - 1e-6, 0.6, radius)
    assert not is_free(box, SIZE, SIZE, math.nan, 0.2, radius)


@given(seed=seeds, moves=st.lists(primitives, max_size=120))
@settings(max_examples=60, deadline=None)
def test_a_robot_stays_free_and_a_refused_move_leaves_the_pose(seed: int, moves: list[int]) -> None:
    boxes, (x, y, heading), (other_x, other_y, _) = reference.scene(seed)
    for primitive in moves:
        before = (x, y, heading)
        x, y, heading, moved = apply_primitive(boxes, SIZE, SIZE, x, y, heading, primitive, other_x, other_y)
        assert is_free(boxes, SIZE, SIZE, x, y, arena.ROBOT_RADIUS)
        assert math.hypot(x - other_x, y - other_y) >= 2 * arena.ROBOT_RADIUS - 1e-9
        if primitive in (arena.FORWARD, arena.BACKWARD):
            assert heading == before[2]
            assert math.hypot(x - before[0], y - before[1]) == pytest.approx(arena.STEP_LENGTH if moved else 0.0, abs=1e-12)
        else:
            assert moved
            assert (x, y) == before[:2]
        if not moved:
            assert (x, y, heading) == before
            sign = 1.0 if primitive == arena.FORWARD else -1.0
            ahead_x = x + sign * arena.STEP_LENGTH * math.cos(heading_radians(heading))
            ahead_y = y + sign * arena.STEP_LENGTH * math.sin(heading_radians(heading))
            reached = math.hypot(ahead_x - other_x, ahead_y - other_y) < 2 * arena.ROBOT_RADIUS + 1e-9
            assert reached or not is_free(boxes, SIZE, SIZE, ahead_x, ahead_y, arena.ROBOT_RADIUS + 1e-9)


@given(heading=headings)
def test_primitives_do_what_they_are_called(heading: int) -> None:
    start = (NO_BOXES, SIZE, SIZE, 0.6, 0.6, heading)
    angle = heading * math.pi / 18
    x, y, h, moved = apply_primitive(*start, arena.FORWARD, *NO_OTHER)
    assert (x, y) == pytest.approx((0.6 + 0.01 * math.cos(angle), 0.6 + 0.01 * math.sin(angle)), abs=1e-15)
    assert (h, moved) == (heading, True)
    back_x, back_y, _, _ = apply_primitive(NO_BOXES, SIZE, SIZE, x, y, heading, arena.BACKWARD, *NO_OTHER)
    assert (back_x, back_y) == pytest.approx((0.6, 0.6), abs=1e-15)
    assert apply_primitive(*start, arena.LEFT, *NO_OTHER)[2] == (heading + 1) % 36
    assert apply_primitive(*start, arena.RIGHT, *NO_OTHER)[2] == (heading - 1) % 36
    assert apply_primitive(*start, arena.STAY, *NO_OTHER) == (0.6, 0.6, heading, True)


@given(seed=seeds, primitive=primitives, quarters=st.integers(1, 3))
@settings(max_examples=60, deadline=None)
def test_turning_the_arena_turns_the_move(seed: int, primitive: int, quarters: int) -> None:
    boxes, place, other = reference.scene(seed)
    moved = apply_primitive(boxes, SIZE, SIZE, *place, primitive, *other[:2])
    start, turned_other = reference.turned_place(*place, quarters), reference.turned_place(*other, quarters)
    turned = apply_primitive(reference.turned(boxes, quarters), SIZE, SIZE, *start, primitive, *turned_other[:2])
    assert turned[:3] == pytest.approx(reference.turned_place(*moved[:3], quarters), abs=1e-12)
    assert turned[3] == moved[3]


@given(heading=headings)
def test_headings_survive_the_bus_and_small_errors(heading: int) -> None:
    angle = heading_radians(heading)
    assert -math.pi <= angle <= math.pi + 1e-12
    for error in (0.0, 0.08, -0.08, 2 * math.pi, -2 * math.pi):
        assert heading_number(angle + error) == heading


def test_heading_tables_are_exactly_symmetric() -> None:
    cosine, sine = arena.HEADING_COSINE, arena.HEADING_SINE
    np.testing.assert_allclose(cosine, np.cos(np.arange(36) * math.pi / 18), atol=1e-15)
    np.testing.assert_allclose(sine, np.sin(np.arange(36) * math.pi / 18), atol=1e-15)
    np.testing.assert_array_equal(cosine, -np.roll(cosine, 18))
    np.testing.assert_array_equal(np.roll(cosine, -9), -sine)


@given(seed=seeds, ends=st.tuples(coordinates, coordinates, coordinates, coordinates))
@settings(max_examples=200, deadline=None)
def test_sight_is_symmetric_and_agrees_with_sampled_points(seed: int, ends: tuple[float, float, float, float]) -> None:
    boxes = boxes_array(make_layout("random", seed))
    x0, y0, x1, y1 = ends
    sees = line_of_sight(boxes, x0, y0, x1, y1)
    assert sees == line_of_sight(boxes, x1, y1, x0, y0)
    part = np.linspace(0.0, 1.0, 1500)[:, None]
    points = np.array([x0, y0]) * (1.0 - part) + np.array([x1, y1]) * part
    distances = [min(box_distance(boxes, index, px, py) for index in range(len(boxes))) for px, py in points.tolist()]
    spacing = math.hypot(x1 - x0, y1 - y0) / 1499
    if min(distances) > spacing:
        assert sees
    if any(reference.inside(box, points).any() for box in boxes):
        assert not sees


def test_sight_along_a_corner_is_symmetric_to_the_last_bit() -> None:
    random = np.random.default_rng(5)
    for seed in range(60):
        boxes = boxes_array(make_layout("random", seed))
        for corner_x, corner_y in reference.corners(boxes[0]):
            for x, y in random.uniform(0.0, SIZE, (20, 2)):
                ends = (x, y, 2.0 * corner_x - x, 2.0 * corner_y - y)
                assert line_of_sight(boxes, *ends) == line_of_sight(boxes, *ends[2:], *ends[:2])


@pytest.mark.parametrize(("spare", "allowed"), [(1e-12, True), (1e-4, True), (-1e-6, False), (-5e-3, False)])
def test_a_robot_stops_where_it_touches_the_other(spare: float, allowed: bool) -> None:
    apart = 2 * arena.ROBOT_RADIUS + arena.STEP_LENGTH + spare
    assert apply_primitive(NO_BOXES, SIZE, SIZE, 0.3, 0.6, 0, arena.FORWARD, 0.3 + apart, 0.6)[3] == allowed
    assert apply_primitive(NO_BOXES, SIZE, SIZE, 0.3, 0.6, 18, arena.BACKWARD, 0.3 + apart, 0.6)[3] == allowed


def test_cameras_look_over_low_boxes() -> None:
    box = np.array([[0.6, 0.6, 0.1, 0.1, 1.0, 0.0, 0.2]])
    assert not line_of_sight(box, 0.3, 0.6, 0.9, 0.6)
    box[0, 6] = arena.MOUNT_HEIGHT - 0.01
    assert line_of_sight(box, 0.3, 0.6, 0.9, 0.6)


def test_goals_lie_on_their_grid() -> None:
    assert arena.GOALS.shape == (121, 2)
    assert arena.GOALS[0] == pytest.approx((0.1, 0.1))
    assert arena.GOALS[11 * 3 + 7] == pytest.approx((0.8, 0.4))
