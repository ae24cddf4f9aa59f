"""Shortest paths against a slow reference, and the controller that drives them."""

from __future__ import annotations

import heapq
import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.world.reference import scene
from vantage.perception.seen_map import blocked, occupancy_of
from vantage.world import search
from vantage.world.arena import ARENA_SIZE, GOALS, ROBOT_RADIUS, STAY
from vantage.world.motion import apply_primitive, is_free
from vantage.world.search import CELL_SIZE, CELLS, CLEARANCE

Blocked = npt.NDArray[np.bool_]
STEPS = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))
NO_BOXES = np.empty((0, 7))
headings = st.integers(0, 35)
coordinates = st.floats(0.07, 1.13)


def random_map(seed: int, density: float) -> Blocked:
    random = np.random.default_rng(seed)
    grid = random.random((CELLS, CELLS)) < density
    grid[:3], grid[-2:], grid[:, :3], grid[:, -2:] = True, True, True, True
    return grid


def reference_costs(grid: Blocked, x: float, y: float, heading: int, reverse: bool) -> dict[tuple[int, int], int]:
    """Textbook Dijkstra from a free start, hundredths of a step: cell -> cost of the cheapest heading."""
    start = (math.floor(y / CELL_SIZE + 0.5), math.floor(x / CELL_SIZE + 0.5))
    done: dict[tuple[int, int, int], int] = {}
    queue = []
    for direction in range(8):
        away = abs(45 * direction - 10 * heading) % 360
        queue.append((10 * min(away, 360 - away), start[0], start[1], direction))
    heapq.heapify(queue)
    while queue:
        cost, row, column, direction = heapq.heappop(queue)
        if (row, column, direction) in done:
            continue
        done[row, column, direction] = cost
        for turned in (direction + 1, direction - 1):
            heapq.heappush(queue, (cost + 450, row, column, turned % 8))
        for sign in (1, -1) if reverse else (1,):
            rows, columns = STEPS[direction]
            there = (row + sign * rows, column + sign * columns)
            if min(there) >= 0 and max(there) < CELLS and not grid[there]:
                heapq.heappush(queue, (cost + (354 if direction % 2 else 250), *there, direction))
    best: dict[tuple[int, int], int] = {}
    for (row, column, _), cost in done.items():
        best[row, column] = min(cost, best.get((row, column), cost))
    return best


def free_start(grid: Blocked, seed: int) -> tuple[float, float, int]:
    random = np.random.default_rng(seed)
    rows, columns = np.nonzero(~grid)
    pick = random.integers(len(rows))
    shift = random.uniform(-0.012, 0.012, 2)
    return float(columns[pick] * CELL_SIZE + shift[0]), float(rows[pick] * CELL_SIZE + shift[1]), int(random.integers(36))


def driven_cost(waypoints: npt.NDArray[np.float64]) -> float:
    return float(np.hypot(*np.diff(waypoints[:, :2], axis=0).T).sum()) / 0.010


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_one_search_and_every_astar_agree_with_the_reference(seed: int, reverse: bool) -> None:
    grid = random_map(seed, 0.05 + 0.1 * seed)
    x, y, heading = free_start(grid, seed)
    expected = reference_costs(grid, x, y, heading, reverse)
    tree = search.shortest_path_tree(grid, x, y, heading, reverse)
    for row in range(CELLS):
        for column in range(CELLS):
            cost = search.cost_to(tree, column * CELL_SIZE, row * CELL_SIZE)
            assert cost == (expected[row, column] / 100 if (row, column) in expected else math.inf)
    random = np.random.default_rng(seed)
    for row, column in random.integers(3, CELLS - 2, (60, 2)):
        waypoints, cost = search.find_path(grid, x, y, heading, column * CELL_SIZE, row * CELL_SIZE, reverse)
        if (row, column) in expected:
            assert cost == expected[row, column]
            assert driven_cost(waypoints) <= cost / 100 + 5
        else:
            assert len(waypoints) == 0
    assert len(expected) > 100


def test_the_bound_of_the_remaining_cost_never_exceeds_it_and_is_consistent() -> None:
    """Over all states and a goal in the open: h <= cost of an edge + h behind it, for every edge."""
    for reverse in (False, True):
        for goal in ((24, 24), (5, 40)):
            bound = np.array([search._remaining(state, *goal, reverse) for state in range(CELLS * CELLS * 8)])
            bound = bound.reshape(CELLS, CELLS, 8)
            assert (bound[goal] == 0).all()
            for turned in (1, -1):
                assert (bound <= 450 + np.roll(bound, turned, axis=2)).all()
            for direction, (rows, columns) in enumerate(STEPS):
                for sign in (1, -1) if reverse else (1,):
                    here = bound[1:-1, 1:-1, direction]
                    ahead = np.roll(bound, (-sign * rows, -sign * columns), axis=(0, 1))[1:-1, 1:-1, direction]
                    assert (here <= (354 if direction % 2 else 250) + ahead).all()


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("seed", range(1, 13))
def test_plans_reach_their_goals_in_time_and_keep_clear_of_boxes(seed: int, reverse: bool) -> None:
    boxes, (x, y, heading), _ = scene(seed)
    tree = search.shortest_path_tree(blocked(occupancy_of(boxes), CLEARANCE), x, y, heading, reverse)
    reached = 0
    for goal_x, goal_y in GOALS:
        waypoints = search.path_to(tree, goal_x, goal_y)
        if not len(waypoints):
            assert search.cost_to(tree, goal_x, goal_y) == math.inf
            continue
        poses = search.roll_out(x, y, heading, waypoints, 600)
        moving = np.nonzero(np.abs(np.diff(poses, axis=0)).sum(axis=1))[0]
        used = int(moving[-1]) + 1 if len(moving) else 0
        assert math.hypot(poses[-1, 0] - goal_x, poses[-1, 1] - goal_y) <= 0.015
        assert used <= 1.3 * search.cost_to(tree, goal_x, goal_y) + 10
        assert all(is_free(boxes, ARENA_SIZE, ARENA_SIZE, px, py, ROBOT_RADIUS) for px, py, _ in poses[: used + 1])
        assert reverse or (waypoints[:, 2] > 0).all()
        reached += 1
    assert reached > 40


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.tuples(coordinates, coordinates, st.sampled_from([1.0, -1.0])), min_size=2, max_size=6),
    st.tuples(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02)),
    headings,
)
def test_following_any_polyline_from_any_pose_ends_at_its_end(
    corners: list[tuple[float, float, float]], shift: tuple[float, float], heading: int
) -> None:
    waypoints = np.array(corners)
    x, y, index = waypoints[0, 0] + shift[0], waypoints[0, 1] + shift[1], 0
    length = np.hypot(*np.diff(waypoints[:, :2], axis=0).T).sum()
    allowed = int(1.3 * length / 0.010) + 25 * len(waypoints) + 10
    been = set()
    for _ in range(allowed):
        place = (x, y, heading, index)
        assert place not in been, f"came back to {place}"
        been.add(place)
        primitive, index = search.follow(x, y, heading, waypoints, index)
        if primitive == STAY:
            break
        x, y, heading, _ = apply_primitive(NO_BOXES, 9.0, 9.0, x + 4.0, y + 4.0, heading, primitive, np.nan, np.nan)
        x, y = x - 4.0, y - 4.0
    assert primitive == STAY
    last = np.hypot(*(waypoints[-1, :2] - waypoints[-2, :2]))
    assert math.hypot(x - waypoints[-1, 0], y - waypoints[-1, 1]) <= 0.015 or last < 0.2


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 60), headings, st.integers(0, 120), st.booleans())
def test_unblocked_play_is_the_plan_to_the_last_bit(seed: int, heading: int, goal: int, reverse: bool) -> None:
    boxes, (x, y, _), _ = scene(seed)
    tree = search.shortest_path_tree(blocked(occupancy_of(boxes), CLEARANCE), x, y, heading, reverse)
    waypoints = search.path_to(tree, *GOALS[goal])
    plan = search.roll_out(x, y, heading, waypoints, 300)
    index = 0
    for step in range(301):
        assert (plan[step, 0], plan[step, 1]) == (x, y)
        assert plan[step, 2] == pytest.approx(math.radians(10 * heading))
        primitive, index = search.follow(x, y, heading, waypoints, index)
        x, y, heading, moved = apply_primitive(boxes, ARENA_SIZE, ARENA_SIZE, x, y, heading, primitive, np.nan, np.nan)
        assert moved


def test_a_robot_that_stands_too_near_to_a_box_drives_straight_out() -> None:
    """On all sides of a box, at the least distance at which a robot can stand."""
    box = np.array([[0.6, 0.6, 0.1, 0.1, 1.0, 0.0, 0.2]])
    grid = blocked(occupancy_of(box), CLEARANCE)
    for angle in np.linspace(0.0, 2.0 * math.pi, 48, endpoint=False):
        reach = 0.1 / max(abs(math.cos(angle)), abs(math.sin(angle))) + 0.066
        x, y = 0.6 + reach * math.cos(angle), 0.6 + reach * math.sin(angle)
        if not is_free(box, ARENA_SIZE, ARENA_SIZE, x, y, ROBOT_RADIUS):
            continue
        tree = search.shortest_path_tree(grid, x, y, 0, True)
        for goal in ((0.2, 0.2), (1.0, 1.0)):
            waypoints = search.path_to(tree, *goal)
            poses = search.roll_out(x, y, 0, waypoints, 400)
            assert math.hypot(poses[-1, 0] - goal[0], poses[-1, 1] - goal[1]) <= 0.015
            assert all(is_free(box, ARENA_SIZE, ARENA_SIZE, px, py, ROBOT_RADIUS - 0.006) for px, py, _ in poses)


def test_refused_cells_are_not_crossed_even_to_escape() -> None:
    grid = np.zeros((CELLS, CELLS), np.uint8)
    grid[18:31, 18:31] = 1
    grid[18:31, 20] = 2  # a wall of refused moves left of the robot, which stands nearer to that side
    waypoints, _ = search.find_path(grid, 22 * CELL_SIZE, 24 * CELL_SIZE, 18, 0.2, 0.6, False)
    assert len(waypoints) == 0 or (waypoints[1, 0] > 22 * CELL_SIZE)
    grid[18:31, 20] = 1
    waypoints, _ = search.find_path(grid, 20 * CELL_SIZE, 24 * CELL_SIZE, 18, 0.2, 0.6, False)
    assert len(waypoints) > 0


def test_a_goal_behind_closed_cells_has_no_path_and_a_robot_without_path_stays() -> None:
    grid = np.zeros((CELLS, CELLS), np.bool_)
    grid[:, 24] = True
    tree = search.shortest_path_tree(grid, 0.3, 0.3, 0, True)
    assert search.path_to(tree, 0.9, 0.3).shape == (0, 3)
    assert search.astar(grid, (0.3, 0.3, 0), (0.9, 0.3), True).shape == (0, 3)
    poses = search.roll_out(0.3, 0.3, 4, np.empty((0, 3)), 5)
    assert (poses == poses[0]).all() and poses.shape == (6, 3)


def test_reverse_saves_the_turn() -> None:
    grid = np.zeros((CELLS, CELLS), np.bool_)
    forwards = search.shortest_path_tree(grid, 0.6, 0.6, 0, False)
    backwards = search.shortest_path_tree(grid, 0.6, 0.6, 0, True)
    assert search.cost_to(backwards, 0.4, 0.6) == pytest.approx(20.0)
    assert search.cost_to(forwards, 0.4, 0.6) == pytest.approx(38.0)
    assert search.path_to(backwards, 0.4, 0.6)[-1].tolist() == [0.4, 0.6, -1.0]


def test_every_goal_is_the_centre_of_a_cell() -> None:
    for x, y in GOALS:
        assert search.cell_of(x) * CELL_SIZE == pytest.approx(x)
        assert search.cell_of(y) * CELL_SIZE == pytest.approx(y)
