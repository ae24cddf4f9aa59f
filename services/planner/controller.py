"""The hider's low-level controller: remembers what its camera has seen, finds a path to a goal and drives it."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from vantage.perception.seen_map import BOUNDARY, SeenMap, blocked, observe
from vantage.perception.state_image import Perceived
from vantage.world import search
from vantage.world.arena import BACKWARD, FORWARD, GOALS, ROBOT_RADIUS, STAY, TURN

_REFUSED = 1e-6  # m; a move of less was refused
_BUMP_REACH = ROBOT_RADIUS + search.CELL_SIZE
_GOAL_CELLS = np.array([[search.cell_of(y), search.cell_of(x)] for x, y in GOALS.tolist()])  # [121, 2] row, column


class Controller:
    """Plans over what has been seen (unknown is free) and re-paths to the same goal when a new obstacle shows.

    Poses are x, y in m, arena frame, and the heading as a number of 10 degrees, 0..35.

    Args:
        privileged: occupancy uint8 [48, 48] of the true layout, to plan with it instead of what was seen (ablation).
    """

    def __init__(self, privileged: NDArray[np.uint8] | None = None) -> None:
        self._map = SeenMap.empty()
        self._privileged = privileged is not None
        if privileged is not None:
            self._map.occupancy[:] = privileged
        self._blocked = blocked(self._map.occupancy, search.CLEARANCE)
        self._goal: tuple[float, float] | None = None
        self._waypoints = np.empty((0, 3))
        self._index = 0
        self._last: tuple[float, float, int] | None = None  # x, y, primitive of the step before
        self._map_changed = False
        self._path_changed = False

    @property
    def arrived(self) -> bool:
        """Whether there is nothing left to drive."""
        return self._goal is None or self._index >= len(self._waypoints)

    @property
    def path_changed(self) -> bool:
        """Whether the path is another one than `planned_path` returned last."""
        return self._path_changed

    def observe(self, view: Perceived, x: float, y: float, heading: int, step: int) -> None:
        """Add one view, and what a refused move tells, to the map."""
        if not self._privileged:
            added = observe(
                self._map.occupancy,
                self._map.last_seen,
                step,
                view.ranges,
                view.kinds,
                view.camera.fx,
                view.camera.cx,
                x,
                y,
                heading * TURN,
            )
            self._map_changed |= added > 0
        if self._last is not None:
            last_x, last_y, primitive = self._last
            if primitive in (FORWARD, BACKWARD) and math.hypot(x - last_x, y - last_y) < _REFUSED:
                self._mark_bump(x, y, heading if primitive == FORWARD else heading + 18)
            self._last = None

    def forget_primitive(self) -> None:
        """The last primitive was not carried out: that the robot stands where it stood is no obstacle."""
        self._last = None

    def reachable_goals(self, x: float, y: float, heading: int) -> NDArray[np.bool_]:
        """Return bool [121]: goals that are not blocked and can be reached, as far as has been seen."""
        tree = self.paths_from(x, y, heading)
        return np.array(
            [not self.is_blocked(goal) and math.isfinite(search.cost_to(tree, *GOALS[goal])) for goal in range(len(GOALS))]
        )

    def is_blocked(self, goal: int) -> bool:
        """Whether the robot cannot stand at a goal, as far as has been seen."""
        self._refresh()
        row, column = _GOAL_CELLS[goal]
        return bool(self._blocked[row, column])

    def paths_from(self, x: float, y: float, heading: int) -> search.Tree:
        """Return the shortest paths to everywhere."""
        self._refresh()
        return search.shortest_path_tree(self._blocked, x, y, heading, True)

    def go_to(self, goal_x: float, goal_y: float, x: float, y: float, heading: int) -> None:
        """Head for a goal from now on."""
        self._goal = (goal_x, goal_y)
        self._refresh()
        self._find_path(x, y, heading)

    def drive(self, x: float, y: float, heading: int) -> int:
        """Return the next primitive towards the goal: to be called once a step, after `observe`."""
        if self._goal is None:
            return STAY
        if self._map_changed:
            self._refresh()
            if self._path_is_blocked(x, y, heading):
                self._find_path(x, y, heading)
        primitive, self._index = search.follow(x, y, heading, self._waypoints, self._index)
        self._last = (x, y, primitive)
        return int(primitive)

    def planned_path(self, x: float, y: float, heading: int, steps: int) -> NDArray[np.float64]:
        """Return the planned poses [steps + 1, 3] (x, y in m, heading in rad), of now and of each later step."""
        self._path_changed = False
        return search.roll_out(x, y, heading, self._waypoints, steps)

    def _refresh(self) -> None:
        if self._map_changed:
            self._map_changed = False
            self._blocked = blocked(self._map.occupancy, search.CLEARANCE)

    def _find_path(self, x: float, y: float, heading: int) -> None:
        assert self._goal is not None
        self._waypoints = search.astar(self._blocked, (x, y, heading), self._goal, True)
        self._index = 0
        self._path_changed = True

    def _path_is_blocked(self, x: float, y: float, heading: int) -> bool:
        """Whether a straight line of the path still to drive crosses a blocked cell (but for the escape from the start)."""
        if len(self._waypoints) == 0:
            return True
        points = [(x, y), *((row[0], row[1]) for row in self._waypoints[max(self._index, 1) :])]
        for (from_x, from_y), (to_x, to_y) in pairwise(points):
            count = max(int(math.hypot(to_x - from_x, to_y - from_y) / search.CELL_SIZE), 1)
            for part in range(1, count + 1):
                at_x, at_y = from_x + (to_x - from_x) * part / count, from_y + (to_y - from_y) * part / count
                near = math.hypot(at_x - x, at_y - y) <= (search.ESCAPE_CELLS - 1) * search.CELL_SIZE
                if not near and self._blocked[search.cell_of(at_y), search.cell_of(at_x)]:
                    return True
        return False

    def _mark_bump(self, x: float, y: float, direction: int) -> None:
        """Remember an obstacle that the camera does not show (it looks forwards) but that refused a move."""
        angle = direction * TURN
        row = search.cell_of(y + _BUMP_REACH * math.sin(angle))
        column = search.cell_of(x + _BUMP_REACH * math.cos(angle))
        if self._map.occupancy[row, column] != BOUNDARY:
            self._map.occupancy[row, column] = BOUNDARY
        self._map_changed = True
        self._waypoints = self._waypoints[:0]
