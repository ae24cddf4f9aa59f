"""Drives the robots to the starts of a game, one after the other, around the boxes and each other."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from services.robot.motion_control import Target
from services.robot.pose_estimate import Place
from vantage.world.arena import HEADINGS, ROBOT_RADIUS, TURN
from vantage.world.search import CELL_SIZE, CELLS, cell_of, cost_to, find_path, shortest_path_tree
from vantage.world.start import Placed

Floats = npt.NDArray[np.float64]

MARGINS = (0.020, 0.012, 0.006)
"""m kept from everything, the widest first that leaves a way."""
DEEP = 0.015
"""m: cells where the robot would stand this deep in something are never crossed, not even to get away."""
SAMPLING = 0.005
"""m between the points at which a straight line is checked."""
PASSING = 0.008
"""m from a corner of the way at which the next line begins."""
ARRIVING = 0.002
PATIENCE = 4.0
"""s for a line of the way, and what its length takes."""
SPEED = 0.05
"""m/s at least, to judge how long a line may take."""
PARKING_PLACES = 60
"""Cells tried to make way for the other robot."""


def clearances(boxes: Floats, width: float, depth: float, x: Floats, y: Floats, other: Place | None) -> Floats:
    """Return the free space around a robot's disc at many points, m, negative where it overlaps something.

    boxes float64 [n, 7]; x, y any shape; the other robot's disc counts where there is one.
    """
    free = np.minimum(np.minimum(x, width - x), np.minimum(y, depth - y)) - ROBOT_RADIUS
    for box_x, box_y, half_width, half_depth, cosine, sine, _ in boxes:
        along = np.maximum(np.abs(cosine * (x - box_x) + sine * (y - box_y)) - half_width, 0.0)
        across = np.maximum(np.abs(cosine * (y - box_y) - sine * (x - box_x)) - half_depth, 0.0)
        free = np.minimum(free, np.hypot(along, across) - ROBOT_RADIUS)
    if other is not None:
        free = np.minimum(free, np.hypot(x - other.x, y - other.y) - 2.0 * ROBOT_RADIUS)
    return free


class Arena:
    """What stands on the table: boxes float64 [n, 7] in width x depth m."""

    def __init__(self, boxes: Floats, width: float, depth: float) -> None:
        self._boxes, self._width, self._depth = boxes, width, depth
        centres = CELL_SIZE * np.arange(CELLS)
        self._x, self._y = np.meshgrid(centres, centres)  # float64 [48, 48], rows along y

    def cells(self, other: Place | None, margin: float) -> npt.NDArray[np.uint8]:
        """Return the map of `vantage.world.search.find_path`, uint8 [48, 48]: 0 free, 1 blocked, 2 never to be crossed."""
        free = clearances(self._boxes, self._width, self._depth, self._x, self._y, other)
        return np.where(free < -DEEP, 2, np.where(free < margin, 1, 0)).astype(np.uint8)

    def clear_line(self, start: tuple[float, float], end: tuple[float, float], other: Place | None) -> bool:
        """Can a robot drive along a straight line without touching anything? m."""
        count = 2 + int(math.dist(start, end) / SAMPLING)
        x, y = np.linspace(start[0], end[0], count), np.linspace(start[1], end[1], count)
        return bool(np.all(clearances(self._boxes, self._width, self._depth, x, y, other) >= -1e-6))

    def route(self, place: Place, goal: Place, other: Place | None) -> list[Target] | None:
        """Return the lines that lead a robot to a goal, which it is to stand at precisely; None when there is no way."""
        if not self.clear_line((goal.x, goal.y), (goal.x, goal.y), other):
            return None
        for margin in MARGINS:
            cells = self.cells(other, margin)
            for x, y in self._gates(cells, goal, other):
                waypoints, _ = find_path(cells, place.x, place.y, round(place.heading / TURN) % HEADINGS, x, y, True)
                if len(waypoints):
                    return _lines(waypoints, place, goal)
        return None

    def reachable(self, place: Place, other: Place | None) -> list[tuple[float, float]]:
        """Return places (m) to stand aside at, the nearest first."""
        cells = self.cells(other, MARGINS[0])
        tree = shortest_path_tree(cells > 0, place.x, place.y, round(place.heading / TURN) % HEADINGS, True)
        costs = []
        for row in range(0, CELLS, 2):
            for column in range(0, CELLS, 2):
                x, y = column * CELL_SIZE, row * CELL_SIZE
                if cells[row, column] == 0 and math.isfinite(cost := cost_to(tree, x, y)):
                    costs.append((cost, x, y))
        return [(x, y) for _, x, y in sorted(costs)]

    def _gates(self, cells: npt.NDArray[np.uint8], goal: Place, other: Place | None) -> list[tuple[float, float]]:
        """Return where a way on the cells may end: at the goal, or at free cells with a clear line to it, the nearest first."""
        row, column = cell_of(goal.y), cell_of(goal.x)
        if cells[row, column] == 0:
            return [(goal.x, goal.y)]
        around = [
            (math.hypot(x - goal.x, y - goal.y), x, y)
            for x, y, blocked in zip(self._x.ravel().tolist(), self._y.ravel().tolist(), cells.ravel().tolist(), strict=True)
            if not blocked and abs(x - goal.x) < 0.1 and abs(y - goal.y) < 0.1
        ]
        return [(x, y) for _, x, y in sorted(around) if self.clear_line((x, y), (goal.x, goal.y), other)][:6]


def _lines(waypoints: Floats, place: Place, goal: Place) -> list[Target]:
    """Turn waypoints float64 [n, 3] (x, y, gear) into targets, the last of them precise."""
    corners = [(x, y, int(gear)) for x, y, gear in waypoints.tolist()]
    first_x, first_y, gear = corners[0]
    if math.hypot(first_x - place.x, first_y - place.y) < PASSING:
        corners = corners[1:]
    last_x, last_y, gear = corners[-1]
    if math.hypot(last_x - goal.x, last_y - goal.y) < 1e-6:
        corners = corners[:-1]
    else:
        gear = 1 if math.cos(math.atan2(goal.y - last_y, goal.x - last_x) - goal.heading) > 0.0 else -1
    lines = []
    x, y = place.x, place.y
    for corner_x, corner_y, corner_gear in corners:
        length = math.hypot(corner_x - x, corner_y - y)
        lines.append(Target(corner_x, corner_y, None, corner_gear, False, PASSING, PATIENCE + length / SPEED))
        x, y = corner_x, corner_y
    length = math.hypot(goal.x - x, goal.y - y)
    lines.append(Target(goal.x, goal.y, math.remainder(goal.heading, math.tau), gear, True, ARRIVING, PATIENCE + length / SPEED))
    return lines


class Placing:
    """Which robot drives where next.

    Args:
        arena: what stands on the table.
        starts: where each robot that is driven from here is to stand.

    Attributes:
        moving: the robot that drives now; None: `plan` next.
    """

    def __init__(self, arena: Arena, starts: Mapping[str, Placed]) -> None:
        self._arena = arena
        self._waiting = {
            robot: Place(x, y, math.remainder(heading * TURN, math.tau)) for robot, (x, y, heading) in starts.items()
        }
        self._lines: list[Target] = []
        self._parking = False
        self.moving: str | None = None

    @property
    def done(self) -> bool:
        """Whether every robot stands at its start."""
        return not self._waiting

    def plan(self, places: Mapping[str, Place]) -> str:
        """Choose who drives next, by where the robots are. Returns why nobody can, for people; empty when somebody does."""
        routes = {robot: self._arena.route(places[robot], goal, _other(places, robot)) for robot, goal in self._waiting.items()}
        # First who, at its start, leaves a way for the other.
        for robot, lines in sorted(routes.items(), key=lambda item: not self._leaves_a_way(item[0], places)):
            if lines is not None:
                self._drive(robot, lines, parking=False)
                return ""
        for robot in self._waiting:
            if self._stand_aside(robot, places):
                return ""
        blocked = " and ".join(f"{robot} at ({goal.x:.2f}, {goal.y:.2f}) m" for robot, goal in self._waiting.items())
        return f"no way to the start of {blocked}: boxes or the other robot are in the way; move them apart"

    def next_line(self) -> Target | None:
        """Return where the moving robot drives now; None when it has arrived."""
        return self._lines[0] if self._lines else None

    def arrived(self) -> None:
        """Take note that the moving robot is at the end of its line."""
        del self._lines[0]
        if not self._lines:
            if not self._parking and self.moving is not None:
                del self._waiting[self.moving]
            self.moving = None

    def interrupted(self) -> None:
        """Take note that the moving robot did not get there: `plan` again."""
        self._lines = []
        self.moving = None

    def _drive(self, robot: str, lines: Sequence[Target], parking: bool) -> None:
        self.moving, self._lines, self._parking = robot, list(lines), parking

    def _leaves_a_way(self, robot: str, places: Mapping[str, Place]) -> bool:
        others = [other for other in self._waiting if other != robot]
        return all(self._arena.route(places[other], self._waiting[other], self._waiting[robot]) is not None for other in others)

    def _stand_aside(self, robot: str, places: Mapping[str, Place]) -> bool:
        """Have a robot drive to where it leaves the other one a way, if there is such a place."""
        others = [other for other in self._waiting if other != robot]
        for x, y in self._arena.reachable(places[robot], _other(places, robot))[:PARKING_PLACES]:
            aside = Place(x, y, places[robot].heading)
            if others and all(
                self._arena.route(places[other], self._waiting[other], aside) is not None
                and self._arena.route(aside, self._waiting[robot], self._waiting[other]) is not None
                for other in others
            ):
                lines = self._arena.route(places[robot], aside, _other(places, robot))
                if lines is not None:
                    self._drive(robot, lines, parking=True)
                    return True
        return False


def _other(places: Mapping[str, Place], robot: str) -> Place | None:
    return next((place for name, place in places.items() if name != robot), None)
