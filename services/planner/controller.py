"""The hider's low-level controller: remembers what its camera has seen, finds a path to a goal and drives it.

Compiled, so that the same code drives the robot and decides millions of simulated games (`learning.roll_outs`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vantage.compiled import kernel
from vantage.perception.seen_map import BOUNDARY, NEVER, SeenMap, blocked, observe
from vantage.perception.state_image import Perceived
from vantage.world import search
from vantage.world.arena import BACKWARD, FORWARD, GOALS, ROBOT_RADIUS, STAY, TURN
from vantage.world.search import CELL_SIZE, CELLS, CLEARANCE, ESCAPE_CELLS, cell_of, find_path, follow

WAYPOINTS = 256
_REFUSED = 1e-6  # m; a move of less was refused
_BUMP_REACH = ROBOT_RADIUS + CELL_SIZE
_GOAL_CELLS = np.array([[cell_of(y), cell_of(x)] for x, y in GOALS.tolist()])  # [121, 2] row, column
_NO_PRIMITIVE = -1

# Rows of ControllerMemory.numbers
_COUNT, _INDEX, _MAP_CHANGED, _PATH_CHANGED, _PRIMITIVE, _PRIVILEGED = range(6)
# Rows of ControllerMemory.points
_GOAL, _LAST = range(2)


class ControllerMemory(NamedTuple):
    """All that the controller carries from one step to the next.

    Attributes:
        occupancy, last_seen: the seen map, [48, 48].
        blocked: bool [48, 48], cells nearer than CLEARANCE to a boundary seen; as of the last refresh.
        waypoints: float64 [256, 3], the path, of which the first `numbers[_COUNT]` rows count.
        numbers: int64 [6], points: float64 [2, 2] (m; NaN = none): see the row names.
    """

    occupancy: NDArray[np.uint8]
    last_seen: NDArray[np.int32]
    blocked: NDArray[np.bool_]
    waypoints: NDArray[np.float64]
    numbers: NDArray[np.int64]
    points: NDArray[np.float64]

    @classmethod
    def empty(cls) -> ControllerMemory:
        seen = SeenMap.empty()
        memory = cls(
            seen.occupancy,
            seen.last_seen,
            np.zeros((CELLS, CELLS), np.bool_),
            np.zeros((WAYPOINTS, 3)),
            np.zeros(6, np.int64),
            np.full((2, 2), np.nan),
        )
        forget_everything(memory)
        return memory


@kernel
def forget_everything(memory: ControllerMemory) -> None:
    """A new episode begins: nothing seen, no goal."""
    memory.occupancy[:] = 0
    memory.last_seen[:] = NEVER
    memory.numbers[:] = 0
    memory.numbers[_PRIMITIVE] = _NO_PRIMITIVE
    memory.numbers[_MAP_CHANGED] = 1
    memory.points[:] = np.nan
    _refresh(memory)


@kernel
def _refresh(memory):  # type: ignore[no-untyped-def]
    if memory.numbers[_MAP_CHANGED]:
        memory.numbers[_MAP_CHANGED] = 0
        memory.blocked[:] = blocked(memory.occupancy, CLEARANCE)


@kernel
def _find_path(memory, x, y, heading):  # type: ignore[no-untyped-def]
    waypoints, _ = find_path(memory.blocked, x, y, heading, memory.points[_GOAL, 0], memory.points[_GOAL, 1], True)
    count = min(len(waypoints), WAYPOINTS)
    memory.waypoints[:count] = waypoints[:count]
    memory.numbers[_COUNT], memory.numbers[_INDEX], memory.numbers[_PATH_CHANGED] = count, 0, 1


@kernel
def _path_is_blocked(memory, x, y):  # type: ignore[no-untyped-def]
    """Whether a straight line of the path still to drive crosses a blocked cell (but for the escape from the start)."""
    if memory.numbers[_COUNT] == 0:
        return True
    from_x, from_y = x, y
    for index in range(max(memory.numbers[_INDEX], 1), memory.numbers[_COUNT]):
        to_x, to_y = memory.waypoints[index, 0], memory.waypoints[index, 1]
        count = max(int(math.hypot(to_x - from_x, to_y - from_y) / CELL_SIZE), 1)
        for part in range(1, count + 1):
            at_x, at_y = from_x + (to_x - from_x) * part / count, from_y + (to_y - from_y) * part / count
            near = math.hypot(at_x - x, at_y - y) <= (ESCAPE_CELLS - 1) * CELL_SIZE
            if not near and memory.blocked[cell_of(at_y), cell_of(at_x)]:
                return True
        from_x, from_y = to_x, to_y
    return False


@kernel
def _mark_bump(memory, x, y, direction):  # type: ignore[no-untyped-def]
    """Remember an obstacle that the camera does not show (it looks forwards) but that refused a move."""
    angle = direction * TURN
    memory.occupancy[cell_of(y + _BUMP_REACH * math.sin(angle)), cell_of(x + _BUMP_REACH * math.cos(angle))] = BOUNDARY
    memory.numbers[_MAP_CHANGED], memory.numbers[_COUNT] = 1, 0


@kernel
def notice(
    memory: ControllerMemory,
    ranges: NDArray[np.float64],
    kinds: NDArray[np.uint8],
    fx: float,
    cx: float,
    x: float,
    y: float,
    heading: int,
    step: int,
) -> None:
    """Add one view, and what a refused move tells, to the map. Arguments as `seen_map.observe`; heading 0..35."""
    if not memory.numbers[_PRIVILEGED]:
        added = observe(memory.occupancy, memory.last_seen, step, ranges, kinds, fx, cx, x, y, heading * TURN)
        if added > 0:
            memory.numbers[_MAP_CHANGED] = 1
    primitive = memory.numbers[_PRIMITIVE]
    if primitive in (FORWARD, BACKWARD) and math.hypot(x - memory.points[_LAST, 0], y - memory.points[_LAST, 1]) < _REFUSED:
        _mark_bump(memory, x, y, heading if primitive == FORWARD else heading + 18)
    memory.numbers[_PRIMITIVE] = _NO_PRIMITIVE


@kernel
def head_for(memory: ControllerMemory, goal_x: float, goal_y: float, x: float, y: float, heading: int) -> None:
    """Head for a goal (m) from now on."""
    memory.points[_GOAL, 0], memory.points[_GOAL, 1] = goal_x, goal_y
    _refresh(memory)
    _find_path(memory, x, y, heading)


@kernel
def next_primitive(memory: ControllerMemory, x: float, y: float, heading: int) -> int:
    """Return the next primitive towards the goal: to be called once a step, after `notice`."""
    if memory.points[_GOAL, 0] != memory.points[_GOAL, 0]:
        return STAY
    if memory.numbers[_MAP_CHANGED]:
        _refresh(memory)
        if _path_is_blocked(memory, x, y):
            _find_path(memory, x, y, heading)
    primitive, index = follow(x, y, heading, memory.waypoints[: memory.numbers[_COUNT]], memory.numbers[_INDEX])
    memory.numbers[_INDEX], memory.numbers[_PRIMITIVE] = index, primitive
    memory.points[_LAST, 0], memory.points[_LAST, 1] = x, y
    return primitive


class Controller:
    """Plans over what has been seen (unknown is free) and re-paths to the same goal when a new obstacle shows.

    Poses are x, y in m, arena frame, and the heading as a number of 10 degrees, 0..35.

    Args:
        privileged: occupancy uint8 [48, 48] of the true layout, to plan with it instead of what was seen (ablation).
    """

    def __init__(self, privileged: NDArray[np.uint8] | None = None) -> None:
        self.memory = ControllerMemory.empty()
        if privileged is not None:
            self.memory.occupancy[:] = privileged
            self.memory.numbers[_PRIVILEGED] = self.memory.numbers[_MAP_CHANGED] = 1
            _refresh(self.memory)

    @property
    def arrived(self) -> bool:
        """Whether there is nothing left to drive."""
        return bool(np.isnan(self.memory.points[_GOAL, 0]) or self.memory.numbers[_INDEX] >= self.memory.numbers[_COUNT])

    @property
    def path_changed(self) -> bool:
        """Whether the path is another one than `planned_path` returned last."""
        return bool(self.memory.numbers[_PATH_CHANGED])

    def observe(self, view: Perceived, x: float, y: float, heading: int, step: int) -> None:
        """Add one view, and what a refused move tells, to the map."""
        notice(self.memory, view.ranges, view.kinds, view.camera.fx, view.camera.cx, x, y, heading, step)

    def forget_primitive(self) -> None:
        """The last primitive was not carried out: that the robot stands where it stood is no obstacle."""
        self.memory.numbers[_PRIMITIVE] = _NO_PRIMITIVE

    def reachable_goals(self, x: float, y: float, heading: int) -> NDArray[np.bool_]:
        """Return bool [121]: goals that are not blocked and can be reached, as far as has been seen."""
        tree = self.paths_from(x, y, heading)
        return np.array(
            [not self.is_blocked(goal) and math.isfinite(search.cost_to(tree, *GOALS[goal])) for goal in range(len(GOALS))]
        )

    def is_blocked(self, goal: int) -> bool:
        """Whether the robot cannot stand at a goal, as far as has been seen."""
        _refresh(self.memory)
        row, column = _GOAL_CELLS[goal]
        return bool(self.memory.blocked[row, column])

    def paths_from(self, x: float, y: float, heading: int) -> search.Tree:
        """Return the shortest paths to everywhere."""
        _refresh(self.memory)
        return search.shortest_path_tree(self.memory.blocked, x, y, heading, True)

    def proposals(self, x: float, y: float, heading: int, steps: int) -> dict[int, NDArray[np.float64]]:
        """Return the planned poses [steps + 1, 3] of the way to every goal that looks free and can be reached, by goal number."""
        tree = self.paths_from(x, y, heading)
        paths = {}
        for goal in range(len(GOALS)):
            if not self.is_blocked(goal) and len(waypoints := search.path_to(tree, *GOALS[goal])):
                paths[goal] = search.roll_out(x, y, heading, waypoints, steps)
        return paths

    def go_to(self, goal_x: float, goal_y: float, x: float, y: float, heading: int) -> None:
        """Head for a goal from now on."""
        head_for(self.memory, goal_x, goal_y, x, y, heading)

    def drive(self, x: float, y: float, heading: int) -> int:
        """Return the next primitive towards the goal: to be called once a step, after `observe`."""
        return int(next_primitive(self.memory, x, y, heading))

    def planned_path(self, x: float, y: float, heading: int, steps: int) -> NDArray[np.float64]:
        """Return the planned poses [steps + 1, 3] (x, y in m, heading in rad), of now and of each later step."""
        self.memory.numbers[_PATH_CHANGED] = 0
        return search.roll_out(x, y, heading, self.memory.waypoints[: self.memory.numbers[_COUNT]], steps)
