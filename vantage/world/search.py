"""Shortest paths on a grid with headings, and the low-level controller that drives them.

Nodes are 48 x 48 cells of 25 mm times 8 headings of 45 degrees. Cell (row, column) is centred on x = 0.025 * column,
y = 0.025 * row, so that every goal of the paper's 11 x 11 grid is a cell's centre. Costs are game steps: 2.5 for a
straight move, 3.54 for a diagonal one, 4.5 for a turn of 45 degrees, so that a path is ranked by the time it takes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

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
    RIGHT,
    ROBOT_RADIUS,
    STAY,
    STEP_LENGTH,
    TURN,
)

CELLS = 48
CELL_SIZE = 0.025
CLEARANCE = ROBOT_RADIUS + 0.020
"""Distance kept from seen boundary cells and walls, m: the robot, 8 mm that `follow` may stray from the line, 2 mm that a
line sinks between two free cells, and 10 mm of the half cell by which a boundary cell's centre may miss the surface. More
would close the gaps between boxes."""

ARRIVED = 0.005  # m of a segment left, at or below which the next one begins
STRAY = 0.007  # m beside the line, beyond which `follow` steers back
SETTLED = 0.001  # m beside the line, at or below which steering back ends
COST_SCALE = 100  # costs are integers of a hundredth of a step
STRAIGHT_COST, DIAGONAL_COST, TURN_COST = 250, 354, 450
ESCAPE_CELLS = 3  # a robot that stands too near to something may cross blocked cells this far from its own, straight ...
ESCAPE_FACTOR = 3  # ... towards the nearest free cell, at this multiple of their cost

_HEADINGS = 8
_STATES = CELLS * CELLS * _HEADINGS
_BUCKETS = 4096  # a power of two, more than the largest difference between two keys in the queue (half a turn and two)
_UNREACHED = 2**30
_ROW_STEP = np.array([0, 1, 1, 1, 0, -1, -1, -1])
_COLUMN_STEP = np.array([1, 1, 0, -1, -1, -1, 0, 1])


class Tree(NamedTuple):
    """Shortest paths from one pose.

    Attributes:
        cost: int32 [18432], hundredths of a step, 2**30 where not reached; state = (row * 48 + column) * 8 + heading.
        parent: int32 [18432], the state before, -1 at the start.
        x, y: the start, m.
        reverse_allowed: whether paths may drive backwards.
    """

    cost: npt.NDArray[np.int32]
    parent: npt.NDArray[np.int32]
    x: float
    y: float
    reverse_allowed: bool


@kernel
def cell_of(coordinate: float) -> int:
    """Return the row or column of the cell that holds a coordinate (m); outside the grid the nearest one."""
    return min(max(math.floor(coordinate / CELL_SIZE + 0.5), 0), CELLS - 1)


@kernel
def _remaining(state, goal_row, goal_column, reverse_allowed):  # type: ignore[no-untyped-def]
    """Return a consistent lower bound of the cost to the goal cell: the free distance, and the turns that no way can avoid.

    At least one turn unless the goal lies straight along the heading; and as many as bring the goal ahead of (or, in
    reverse, behind) the robot, for driving away from the goal never brings it there.
    """
    if goal_row < 0:
        return 0
    cell, direction = state >> 3, state & 7
    row = cell // CELLS
    rows, columns = goal_row - row, goal_column - (cell - row * CELLS)
    if rows == 0 and columns == 0:
        return 0
    short, long = min(abs(rows), abs(columns)), max(abs(rows), abs(columns))
    ahead, beside = _ROW_STEP[direction], _COLUMN_STEP[direction]
    along = rows * ahead + columns * beside
    turns = 0
    if rows * beside != columns * ahead or (along < 0 and not reverse_allowed):
        turns = 1
        if along <= 0 and not reverse_allowed:
            for turned in (1, 7):
                other = (direction + turned) & 7
                if rows * _ROW_STEP[other] + columns * _COLUMN_STEP[other] > 0:
                    break
            else:
                turns = 2
    return DIAGONAL_COST * short + STRAIGHT_COST * (long - short) + TURN_COST * turns


@kernel
def _relax(state, cost, before, goal_row, goal_column, reverse_allowed, costs, parents, heads, nexts, previous):  # type: ignore[no-untyped-def]
    """Offer a cheaper way to `state`; the queue is an array of doubly linked lists, one a key modulo _BUCKETS."""
    old = costs[state]
    if cost >= old:
        return 0
    estimate = _remaining(state, goal_row, goal_column, reverse_allowed)
    added = 1
    if old < _UNREACHED:
        after, ahead = nexts[state], previous[state]
        if ahead >= 0:
            nexts[ahead] = after
        else:
            heads[(old + estimate) & (_BUCKETS - 1)] = after
        if after >= 0:
            previous[after] = ahead
        added = 0
    bucket = (cost + estimate) & (_BUCKETS - 1)
    costs[state], parents[state] = cost, before
    head = heads[bucket]
    nexts[state], previous[state] = head, -1
    if head >= 0:
        previous[head] = state
    heads[bucket] = state
    return added


@kernel
def _escape_depths(blocked, start_row, start_column):  # type: ignore[no-untyped-def]
    """Return the squared distance (cells) to the nearest free cell for the cells around a blocked start, else nothing."""
    if not blocked[start_row, start_column]:
        return np.empty((0, 0), np.int64)
    size = 2 * ESCAPE_CELLS + 1
    depths = np.full((size, size), _UNREACHED)
    for row in range(max(start_row - 2 * ESCAPE_CELLS, 0), min(start_row + 2 * ESCAPE_CELLS + 1, CELLS)):
        for column in range(max(start_column - 2 * ESCAPE_CELLS, 0), min(start_column + 2 * ESCAPE_CELLS + 1, CELLS)):
            if not blocked[row, column]:
                for i in range(size):
                    for j in range(size):
                        rows, columns = start_row + i - ESCAPE_CELLS - row, start_column + j - ESCAPE_CELLS - column
                        depths[i, j] = min(depths[i, j], rows * rows + columns * columns)
    return depths


@kernel
def _depth(depths, rows, columns):  # type: ignore[no-untyped-def]
    if max(abs(rows), abs(columns)) > ESCAPE_CELLS or len(depths) == 0:
        return _UNREACHED
    return depths[rows + ESCAPE_CELLS, columns + ESCAPE_CELLS]


@kernel
def _search(blocked, x, y, heading, goal_row, goal_column, reverse_allowed):  # type: ignore[no-untyped-def]
    """Dijkstra over all states (goal_row < 0), or A* that ends at the goal cell; returns (costs, parents, goal state or -1)."""
    costs = np.full(_STATES, _UNREACHED, np.int32)
    parents = np.empty(_STATES, np.int32)
    nexts = np.empty(_STATES, np.int32)
    previous = np.empty(_STATES, np.int32)
    heads = np.full(_BUCKETS, -1, np.int32)
    start_row, start_column = cell_of(y), cell_of(x)
    start = (start_row * CELLS + start_column) * _HEADINGS
    waiting, key = 0, _UNREACHED
    for direction in range(_HEADINGS):
        turn = abs((45 * direction - 10 * heading + 180) % 360 - 180)
        cost = COST_SCALE * turn // 10
        key = min(key, cost + _remaining(start + direction, goal_row, goal_column, reverse_allowed))
        waiting += _relax(
            start + direction, cost, -1, goal_row, goal_column, reverse_allowed, costs, parents, heads, nexts, previous
        )
    escape = _escape_depths(blocked, start_row, start_column)
    while waiting > 0:
        bucket = key & (_BUCKETS - 1)
        state = heads[bucket]
        if state < 0:
            key += 1
            continue
        after = nexts[state]
        heads[bucket] = after
        if after >= 0:
            previous[after] = -1
        waiting -= 1
        cell, direction = state >> 3, state & 7
        row = cell // CELLS
        column = cell - row * CELLS
        if row == goal_row and column == goal_column:
            return costs, parents, state
        cost = costs[state]
        for turned in (1, _HEADINGS - 1):
            other = cell * _HEADINGS + ((direction + turned) & 7)
            waiting += _relax(
                other, cost + TURN_COST, state, goal_row, goal_column, reverse_allowed, costs, parents, heads, nexts, previous
            )
        for gear in range(2 if reverse_allowed else 1):
            travel = (direction + 4 * gear) & 7
            next_row, next_column = row + _ROW_STEP[travel], column + _COLUMN_STEP[travel]
            if next_row < 0 or next_row >= CELLS or next_column < 0 or next_column >= CELLS:
                continue
            step_cost = DIAGONAL_COST if travel % 2 else STRAIGHT_COST
            if blocked[next_row, next_column]:
                if (
                    blocked[next_row, next_column] > 1
                    or not blocked[row, column]
                    or _depth(escape, row - start_row, column - start_column)
                    <= _depth(escape, next_row - start_row, next_column - start_column)
                ):
                    continue
                step_cost *= ESCAPE_FACTOR
            other = (next_row * CELLS + next_column) * _HEADINGS + direction
            waiting += _relax(
                other, cost + step_cost, state, goal_row, goal_column, reverse_allowed, costs, parents, heads, nexts, previous
            )
    return costs, parents, -1


@kernel
def _runs(parents, state, waypoints):  # type: ignore[no-untyped-def]
    """Walk back from `state`; fill `waypoints` (from its last row up) with the ends of straight runs; return their number."""
    room = len(waypoints)
    count, last_travel, last_gear = 0, -1, 0
    while parents[state] >= 0:
        before = parents[state]
        cell, cell_before = state >> 3, before >> 3
        if cell != cell_before:
            direction = state & 7
            gear = 1
            row, column = cell // CELLS, cell % CELLS
            if row - cell_before // CELLS != _ROW_STEP[direction] or column - cell_before % CELLS != _COLUMN_STEP[direction]:
                gear = -1
            if direction != last_travel or gear != last_gear:
                count += 1
                if room:
                    waypoints[room - count, 0] = column * CELL_SIZE
                    waypoints[room - count, 1] = row * CELL_SIZE
                    waypoints[room - count, 2] = gear
                last_travel, last_gear = direction, gear
        state = before
    return count


@kernel
def _waypoints(parents, state, x, y, goal_x, goal_y, reverse_allowed, heading):  # type: ignore[no-untyped-def]
    count = _runs(parents, state, np.empty((0, 3)))
    waypoints = np.empty((max(count, 1) + 1, 3))
    if count:
        _runs(parents, state, waypoints)
    else:
        bearing = math.atan2(goal_y - y, goal_x - x) - math.radians(10.0 * heading)
        waypoints[1, 2] = -1.0 if reverse_allowed and math.cos(bearing) < 0.0 else 1.0
    waypoints[-1, 0], waypoints[-1, 1] = goal_x, goal_y
    waypoints[0, 0], waypoints[0, 1], waypoints[0, 2] = x, y, waypoints[1, 2]
    if count > 1:
        # The first line starts at the robot where that hardly changes its direction, else at the centre of its cell.
        centre_x, centre_y = cell_of(x) * CELL_SIZE, cell_of(y) * CELL_SIZE
        grid = math.atan2(waypoints[1, 1] - centre_y, waypoints[1, 0] - centre_x)
        direct = math.atan2(waypoints[1, 1] - y, waypoints[1, 0] - x)
        if math.cos(grid - direct) < math.cos(math.radians(10.0)):
            waypoints[0, 0], waypoints[0, 1] = centre_x, centre_y
    return waypoints


@kernel
def _tree_end(costs, goal_row, goal_column):  # type: ignore[no-untyped-def]
    first = (goal_row * CELLS + goal_column) * _HEADINGS
    best = first
    for state in range(first + 1, first + _HEADINGS):
        if costs[state] < costs[best]:
            best = state
    return best if costs[best] < _UNREACHED else -1


@kernel
def _path_to(costs, parents, x, y, reverse_allowed, goal_x, goal_y):  # type: ignore[no-untyped-def]
    end = _tree_end(costs, cell_of(goal_y), cell_of(goal_x))
    if end < 0:
        return np.empty((0, 3))
    start = (cell_of(y) * CELLS + cell_of(x)) * _HEADINGS
    nearest = start  # the start's cheapest direction is the robot's own heading
    for state in range(start + 1, start + _HEADINGS):
        if costs[state] < costs[nearest]:
            nearest = state
    return _waypoints(parents, end, x, y, goal_x, goal_y, reverse_allowed, round(4.5 * (nearest - start)))


def shortest_path_tree(blocked: npt.NDArray[np.bool_], x: float, y: float, heading: int, reverse_allowed: bool) -> Tree:
    """Return the shortest paths from a pose to every cell, by one Dijkstra search.

    A start inside a blocked cell may be left: blocked cells within ESCAPE_CELLS of it can be crossed on the way out.

    Args:
        blocked: bool [48, 48], rows along y; see `vantage.perception.seen_map.blocked`.
        x, y: m, arena frame.
        heading: 0..35, units of 10 degrees.
        reverse_allowed: whether the robot may drive backwards (this saves turns).
    """
    costs, parents, _ = _search(blocked, x, y, heading, -1, -1, reverse_allowed)
    return Tree(costs, parents, x, y, reverse_allowed)


def cost_to(tree: Tree, goal_x: float, goal_y: float) -> float:
    """Return the steps to a goal (m), infinity where it cannot be reached."""
    end = _tree_end(tree.cost, cell_of(goal_y), cell_of(goal_x))
    return float(tree.cost[end]) / COST_SCALE if end >= 0 else math.inf


def path_to(tree: Tree, goal_x: float, goal_y: float) -> npt.NDArray[np.float64]:
    """Return the waypoints float64 [n, 3] (x, y in m, gear +1 forward or -1 backward) of the shortest path to a goal.

    Row 0 is where the first line begins; each later row is the end of a straight line, driven in that row's gear; the
    last is the goal itself. Empty when the goal cannot be reached.
    """
    return _path_to(tree.cost, tree.parent, tree.x, tree.y, tree.reverse_allowed, goal_x, goal_y)


@kernel
def find_path(blocked, x, y, heading, goal_x, goal_y, reverse_allowed):  # type: ignore[no-untyped-def]
    """A* from a pose to a goal for use inside kernels; returns (waypoints as `path_to`, cost in hundredths of a step).

    `blocked` may also be uint8 [48, 48]: 0 free, 1 blocked, 2 blocked and not to be crossed on the way out of a blocked start.
    """
    costs, parents, end = _search(blocked, x, y, heading, cell_of(goal_y), cell_of(goal_x), reverse_allowed)
    if end < 0:
        return np.empty((0, 3)), _UNREACHED
    return _waypoints(parents, end, x, y, goal_x, goal_y, reverse_allowed, heading), costs[end]


def astar(
    blocked: npt.NDArray[np.bool_], start: tuple[float, float, int], goal: tuple[float, float], reverse_allowed: bool
) -> npt.NDArray[np.float64]:
    """Return the waypoints of the shortest path from a pose (x, y in m, heading 0..35) to one goal (m); see `path_to`."""
    waypoints, _ = find_path(blocked, start[0], start[1], start[2], goal[0], goal[1], reverse_allowed)
    return waypoints


@kernel
def follow(x: float, y: float, heading: int, waypoints: npt.NDArray[np.float64], index: int) -> tuple[int, int]:
    """Return the next primitive along waypoints, and the index of the waypoint it leads to (begin with 0).

    Turns until the heading is within 5 degrees of the line, then drives. Off the line by more than STRAY it steers
    back with the neighbouring heading until it has crossed. What it does depends on the pose and the index alone, and
    the bands do not touch: no pose makes it turn to and fro. Stays after the last waypoint.
    """
    index = max(index, 1)
    while index < len(waypoints):
        from_x, from_y = waypoints[index - 1, 0], waypoints[index - 1, 1]
        line_x, line_y = waypoints[index, 0] - from_x, waypoints[index, 1] - from_y
        length = math.hypot(line_x, line_y)
        if length < 1e-9:
            index += 1
            continue
        line_x, line_y = line_x / length, line_y / length
        left = (waypoints[index, 0] - x) * line_x + (waypoints[index, 1] - y) * line_y
        if left <= ARRIVED:
            index += 1
            continue
        beside = line_x * (y - from_y) - line_y * (x - from_x)
        forwards = waypoints[index, 2] > 0.0
        bearing = math.degrees(math.atan2(line_y, line_x)) + (0.0 if forwards else 180.0)
        error = (10.0 * heading - bearing + 180.0) % 360.0 - 180.0
        off = abs(error)
        inward = -error if beside > 0.0 else error  # > 0: driving brings the robot nearer to the line
        drive = FORWARD if forwards else BACKWARD
        if off <= 5.01:
            if abs(beside) > STRAY and inward < 0.5 and left > 3.0 * STEP_LENGTH:
                return (RIGHT if beside > 0.0 else LEFT), index
            return drive, index
        if off <= 10.51 and inward > 0.0 and abs(beside) > SETTLED:
            return drive, index
        return (LEFT if error < 0.0 else RIGHT), index
    return STAY, index


@kernel
def roll_out(x: float, y: float, heading: int, waypoints: npt.NDArray[np.float64], steps: int) -> npt.NDArray[np.float64]:
    """Return the planned poses float64 [steps + 1, 3] (x, y in m, heading in radians) when nothing refuses a move."""
    poses = np.empty((steps + 1, 3))
    index = 0
    for step in range(steps + 1):
        poses[step, 0], poses[step, 1], poses[step, 2] = x, y, heading * TURN
        primitive, index = follow(x, y, heading, waypoints, index)
        if primitive == LEFT:
            heading = (heading + 1) % HEADINGS
        elif primitive == RIGHT:
            heading = (heading + HEADINGS - 1) % HEADINGS
        elif primitive != STAY:
            length = STEP_LENGTH if primitive == FORWARD else -STEP_LENGTH
            x += length * HEADING_COSINE[heading]
            y += length * HEADING_SINE[heading]
    return poses
