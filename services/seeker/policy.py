"""The seeker's policy, one compiled kernel a step: a heuristic expert (paper, Opponent: visible -> A* to the hider,
lost -> its last known position, then explore continuously).

It knows nothing but its own pose and views. Obstacles enter its seen map at every step; the hider's position only at a
look. The presets differ in when they look and in what counts as seeing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vantage.compiled import kernel
from vantage.perception.seen_map import NEVER, SeenMap, measure, observe, too_near
from vantage.perception.state_image import SEEN_COLUMNS
from vantage.world.arena import BACKWARD, FORWARD, GOALS, LEFT, RIGHT, ROBOT_RADIUS, STAY, STEP_LENGTH
from vantage.world.motion import heading_number
from vantage.world.noise import uniform
from vantage.world.search import CELL_SIZE, CELLS, CLEARANCE, cell_of, find_path, follow


class Attention(NamedTuple):
    """A preset. Between looks the seeker is blind for the hider, whatever it is doing; obstacles enter its map at every step.

    Attributes:
        look_interval: steps between looks.
        needs_whole: whether the whole disc must be in view at a look; else SEEN_COLUMNS columns are enough.
        cuts_corners: whether it drives straight to what it can reach straight, or keeps to the headings of A*'s grid. Who
            cuts corners keeps the hider in view, so that rare looks alone hardly weaken it.
    """

    look_interval: int
    needs_whole: bool
    cuts_corners: bool


# `glancing` is set so that a clock alone judges the game about as badly as in the study the project began with: measured over
# 300 goal walks, a predictor that knows only the horizon is right in .70 / .78 of all cases up to step 100 / 200.
PRESETS = {"expert": Attention(1, False, True), "glancing": Attention(30, True, False)}

LONG_AGO = -(10**9)  # step of the last look before the first one
EXPLORE, CHASE, RECALL = 0, 1, 2  # RECALL: on the way to the last known place

CONTACT = 0.145  # m between centres at which a seeker that sees the hider stands still and faces it (catches ignored)
RECALLED = 0.030  # m from the last known place at which it counts as reached
VISITED = 0.060  # m from a place to explore at which it counts as reached
REFRESH = 0.050  # m that the hider moves before a path round obstacles is planned anew
KEPT = (
    ROBOT_RADIUS + 0.006
)  # m kept from boundary cells: less than CLEARANCE, a chaser may brush a box (about one move in 900 is refused)
BUMP_STEPS = 80  # steps for which a place that refused a move is avoided
NEVER_AGE = 100  # steps added to the age of a place that was never in view
AGE_NOISE = 60.0  # steps, width of the uniform noise on a place's age
TRAVEL_WEIGHT = 0.5  # by which the steps to a place lower its age
EXPLORATION_STREAM = 16  # of vantage.world.noise
LEAVING = 0.050  # m for which a straight line may run through the blocked cells that the robot stands in
WAYPOINTS = 64

# Rows of SeekerMemory.numbers
_MODE, _COUNT, _INDEX, _LOOKED, _PRIMITIVE, _PLACE, _CHOSEN, _REPLAN, _BUMPED, _DRAWS = range(10)
# Rows of SeekerMemory.points
_TARGET, _PLANNED, _LAST = range(3)


class SeekerMemory(NamedTuple):
    """All that a seeker carries from one step to the next.

    Attributes:
        occupancy, last_seen: the seen map, [48, 48].
        bumps: int32 [48, 48], the step until which a cell is avoided because a move into it was refused.
        squares: uint8 [48, 48], squared distance in cells to the nearest boundary cell or wall, 0 where a move was refused.
        waypoints: float64 [64, 3], the path, of which the first `numbers[_COUNT]` rows count.
        numbers: int64 [10], points: float64 [3, 2] (m): see the row names.
    """

    occupancy: npt.NDArray[np.uint8]
    last_seen: npt.NDArray[np.int32]
    bumps: npt.NDArray[np.int32]
    squares: npt.NDArray[np.uint8]
    waypoints: npt.NDArray[np.float64]
    numbers: npt.NDArray[np.int64]
    points: npt.NDArray[np.float64]

    @classmethod
    def empty(cls) -> SeekerMemory:
        seen = SeenMap.empty()
        memory = cls(
            seen.occupancy,
            seen.last_seen,
            np.zeros((CELLS, CELLS), np.int32),
            np.zeros((CELLS, CELLS), np.uint8),
            np.zeros((WAYPOINTS, 3)),
            np.zeros(10, np.int64),
            np.full((3, 2), np.nan),
        )
        reset(memory)
        return memory

    @property
    def mode(self) -> int:
        """EXPLORE, CHASE or RECALL."""
        return int(self.numbers[_MODE])

    @property
    def path(self) -> npt.NDArray[np.float64]:
        """Waypoints float64 [n, 3] now followed."""
        return self.waypoints[: self.numbers[_COUNT]]


@kernel
def reset(memory: SeekerMemory) -> None:
    """Forget everything: a new episode begins."""
    memory.occupancy[:] = 0
    memory.last_seen[:] = NEVER
    memory.bumps[:] = 0
    memory.numbers[:] = 0
    memory.numbers[_PLACE] = -1
    memory.numbers[_LOOKED] = LONG_AGO
    memory.points[:] = np.nan
    measure(memory.occupancy, memory.squares)


@kernel
def forget_primitive(memory: SeekerMemory) -> None:
    """The last command was not carried out: that the robot stands where it stood is no collision."""
    memory.numbers[_PRIMITIVE] = STAY


@kernel
def _update_squares(memory, step):  # type: ignore[no-untyped-def]
    measure(memory.occupancy, memory.squares)
    if memory.numbers[_BUMPED] > step:
        for row in range(CELLS):
            for column in range(CELLS):
                if memory.bumps[row, column] > step:
                    memory.squares[row, column] = 0


@kernel
def _note_bump(memory, step, x, y, heading):  # type: ignore[no-untyped-def]
    """The robot's centre cannot go on from here: avoid the cells just ahead."""
    ahead_x, ahead_y = x + 0.030 * math.cos(heading), y + 0.030 * math.sin(heading)
    row, column = cell_of(ahead_y), cell_of(ahead_x)
    for i in range(max(row - 1, 0), min(row + 2, CELLS)):
        for j in range(max(column - 1, 0), min(column + 2, CELLS)):
            if math.hypot(j * CELL_SIZE - ahead_x, i * CELL_SIZE - ahead_y) <= 0.025:
                memory.bumps[i, j] = step + BUMP_STEPS
    memory.numbers[_BUMPED] = step + BUMP_STEPS


@kernel
def _line_is_free(squares, from_x, from_y, to_x, to_y, spared):  # type: ignore[no-untyped-def]
    """Whether a line but for its last `spared` m crosses no cell nearer than KEPT; leaving one within LEAVING m is
    allowed, but not across an obstacle or a refused move.
    """
    length = math.hypot(to_x - from_x, to_y - from_y)
    samples = math.ceil(max(length - spared, min(length, LEAVING)) / (0.5 * CELL_SIZE))
    leaving = True
    for i in range(samples):
        along = i * 0.5 * CELL_SIZE
        part = along / length
        square = squares[cell_of(from_y + part * (to_y - from_y)), cell_of(from_x + part * (to_x - from_x))]
        if square >= too_near(KEPT):
            leaving = False
        elif not leaving or along > LEAVING or (square == 0 and i > 0):
            return False
    return True


@kernel
def _path_is_free(memory, x, y, spared):  # type: ignore[no-untyped-def]
    index = max(memory.numbers[_INDEX], 1)
    for i in range(index, memory.numbers[_COUNT]):
        last = spared if i == memory.numbers[_COUNT] - 1 else 0.0
        if not _line_is_free(memory.squares, x, y, memory.waypoints[i, 0], memory.waypoints[i, 1], last):
            return False
        x, y = memory.waypoints[i, 0], memory.waypoints[i, 1]
    return True


@kernel
def _free_cell_near(blocked, x, y):  # type: ignore[no-untyped-def]
    """The place itself if its cell is free, else the centre of the nearest free cell within 200 mm (NaN: none)."""
    row, column = cell_of(y), cell_of(x)
    if not blocked[row, column]:
        return x, y
    best, best_x, best_y = 0.2, np.nan, np.nan
    for i in range(max(row - 8, 0), min(row + 9, CELLS)):
        for j in range(max(column - 8, 0), min(column + 9, CELLS)):
            distance = math.hypot(j * CELL_SIZE - x, i * CELL_SIZE - y)
            if not blocked[i, j] and distance < best:
                best, best_x, best_y = distance, j * CELL_SIZE, i * CELL_SIZE
    return best_x, best_y


@kernel
def _go_straight(memory, x, y, to_x, to_y):  # type: ignore[no-untyped-def]
    memory.waypoints[0, 0], memory.waypoints[0, 1], memory.waypoints[0, 2] = x, y, 1.0
    memory.waypoints[1, 0], memory.waypoints[1, 1], memory.waypoints[1, 2] = to_x, to_y, 1.0
    memory.numbers[_COUNT], memory.numbers[_INDEX] = 2, 1


@kernel
def _take_path(memory, waypoints, x, y, spared, cuts_corners):  # type: ignore[no-untyped-def]
    """Adopt a path of the grid; who cuts corners goes from each waypoint straight to the last one within free reach."""
    if not cuts_corners:
        count = min(len(waypoints), WAYPOINTS)
        memory.waypoints[:count] = waypoints[:count]
        memory.numbers[_COUNT], memory.numbers[_INDEX] = count, 1
        return
    memory.waypoints[0, 0], memory.waypoints[0, 1], memory.waypoints[0, 2] = x, y, 1.0
    count, last = 1, len(waypoints) - 1
    index = 0
    while index < last and count < WAYPOINTS:
        here_x, here_y = memory.waypoints[count - 1, 0], memory.waypoints[count - 1, 1]
        following = last
        while following > index + 1:
            if _line_is_free(
                memory.squares,
                here_x,
                here_y,
                waypoints[following, 0],
                waypoints[following, 1],
                spared if following == last else 0.0,
            ):
                break
            following -= 1
        memory.waypoints[count] = waypoints[following]
        index = following
        count += 1
    memory.numbers[_COUNT], memory.numbers[_INDEX] = count, 1


@kernel
def _go(memory, x, y, heading, to_x, to_y, spared, cuts_corners):  # type: ignore[no-untyped-def]
    """Plan to a place: straight where the preset and the map allow it, else by A*. Returns whether there is a way."""
    if cuts_corners and _line_is_free(memory.squares, x, y, to_x, to_y, spared):
        _go_straight(memory, x, y, to_x, to_y)
        return True
    memory.numbers[_COUNT] = 0
    blocked = np.zeros((CELLS, CELLS), np.uint8)
    for row in range(CELLS):
        for column in range(CELLS):
            square = memory.squares[row, column]
            blocked[row, column] = 2 if square == 0 else square < too_near(KEPT)
    goal_x, goal_y = _free_cell_near(blocked, to_x, to_y)
    if goal_x == goal_x:
        waypoints, _ = find_path(blocked, x, y, heading, goal_x, goal_y, False)
        if len(waypoints) > 0:
            _take_path(memory, waypoints, x, y, spared, cuts_corners)
    return memory.numbers[_COUNT] > 0


@kernel
def _choose_place(memory, seed, step, x, y, heading, cuts_corners):  # type: ignore[no-untyped-def]
    """Set out for the least recently seen place, with noise; each place is a goal with the cells around it."""
    scores = np.empty(len(GOALS))
    for place in range(len(GOALS)):
        place_x, place_y = GOALS[place, 0], GOALS[place, 1]
        row, column = cell_of(place_y), cell_of(place_x)
        if memory.squares[row, column] < too_near(CLEARANCE):
            scores[place] = -np.inf
            continue
        age = 0.0
        for i in range(row - 1, row + 3):
            for j in range(column - 1, column + 3):
                seen = memory.last_seen[i, j]
                age += step + NEVER_AGE if seen == NEVER else step - seen
        away_x, away_y = place_x - x, place_y - y
        turn = abs((math.atan2(away_y, away_x) - heading + math.pi) % (2.0 * math.pi) - math.pi) * (18.0 / math.pi)
        travel = math.hypot(away_x, away_y) / STEP_LENGTH + turn
        noise = AGE_NOISE * uniform(seed, EXPLORATION_STREAM, memory.numbers[_DRAWS], place)
        scores[place] = age / 16.0 - TRAVEL_WEIGHT * travel + noise
    memory.numbers[_DRAWS] += 1
    number = heading_number(heading)
    for _ in range(3):
        best = np.argmax(scores)
        if scores[best] == -np.inf:
            break
        if _go(memory, x, y, number, GOALS[best, 0], GOALS[best, 1], 0.0, cuts_corners):
            memory.numbers[_PLACE], memory.numbers[_CHOSEN] = best, step
            return
        scores[best] = -np.inf
    memory.numbers[_PLACE], memory.numbers[_COUNT] = -1, 0


@kernel
def _look(memory, step, look_interval, needs_whole, seen_columns, whole, other_x, other_y):  # type: ignore[no-untyped-def]
    """Attend to the hider if it is time to, and set the mode. Returns whether there is a new target."""
    numbers = memory.numbers
    if step - numbers[_LOOKED] < look_interval:
        return False
    numbers[_LOOKED] = step
    if seen_columns < SEEN_COLUMNS or (needs_whole and not whole):
        if numbers[_MODE] == CHASE:
            numbers[_MODE] = RECALL
        return False
    fresh = numbers[_MODE] == EXPLORE
    numbers[_MODE] = CHASE
    memory.points[_TARGET, 0], memory.points[_TARGET, 1] = other_x, other_y
    moved = math.hypot(other_x - memory.points[_PLANNED, 0], other_y - memory.points[_PLANNED, 1])
    return fresh or not moved < REFRESH or numbers[_COUNT] == 2


@kernel
def seeker_step(
    memory: SeekerMemory,
    look_interval: int,
    needs_whole: bool,
    cuts_corners: bool,
    seed: int,
    step: int,
    ranges: npt.NDArray[np.float64],
    kinds: npt.NDArray[np.uint8],
    fx: float,
    cx: float,
    x: float,
    y: float,
    heading: float,
    seen_columns: int,
    whole: bool,
    other_x: float,
    other_y: float,
) -> int:
    """Return the seeker's primitive for this step; deterministic in its arguments.

    Args:
        memory: changed in place.
        look_interval, needs_whole, cuts_corners: the preset, see `Attention`.
        seed: of the episode; drives the noise of the exploration.
        step: of the episode.
        ranges, kinds: [W], of `scan_columns`; fx, cx: px.
        x, y, heading: own pose, m, m, rad, arena frame.
        seen_columns, whole, other_x, other_y: of `find_other`, from the same view.
    """
    numbers, points = memory.numbers, memory.points
    number = heading_number(heading)
    travelled = math.hypot(x - points[_LAST, 0], y - points[_LAST, 1])
    touching = seen_columns >= SEEN_COLUMNS and math.hypot(other_x - x, other_y - y) <= CONTACT
    replan = False
    if numbers[_PRIMITIVE] == FORWARD and travelled < 0.4 * STEP_LENGTH and not touching:
        _note_bump(memory, step, x, y, heading)
        replan = True
    points[_LAST, 0], points[_LAST, 1] = x, y

    added = observe(memory.occupancy, memory.last_seen, step, ranges, kinds, fx, cx, x, y, heading)
    if added > 0 or replan:
        _update_squares(memory, step)
        numbers[_REPLAN] = 1

    if touching:  # only where catches are ignored
        numbers[_MODE], numbers[_LOOKED], numbers[_COUNT], numbers[_REPLAN] = CHASE, step, 0, 1
        points[_TARGET, 0], points[_TARGET, 1] = other_x, other_y
        error = (math.atan2(other_y - y, other_x - x) - heading + math.pi) % (2.0 * math.pi) - math.pi
        primitive = STAY if abs(error) <= math.radians(6.0) else (LEFT if error > 0.0 else RIGHT)
        numbers[_PRIMITIVE] = primitive
        return primitive

    if numbers[_MODE] != EXPLORE:
        distance = math.hypot(points[_TARGET, 0] - x, points[_TARGET, 1] - y)
        if distance <= RECALLED and (numbers[_MODE] == RECALL or step > numbers[_LOOKED]):
            numbers[_MODE], numbers[_PLACE] = EXPLORE, -1
    if _look(memory, step, look_interval, needs_whole, seen_columns, whole, other_x, other_y):
        replan = True
    if numbers[_REPLAN] == 1 and not replan:
        spared = CONTACT if numbers[_MODE] == CHASE else 0.0
        replan = not _path_is_free(memory, x, y, spared)
    numbers[_REPLAN] = 0

    primitive = STAY
    for attempt in range(2):
        if numbers[_MODE] == EXPLORE:
            place = numbers[_PLACE]
            if place >= 0 and not replan:
                place_x, place_y = GOALS[place, 0], GOALS[place, 1]
                seen_since = memory.last_seen[cell_of(place_y), cell_of(place_x)] > numbers[_CHOSEN]
                replan = seen_since or math.hypot(place_x - x, place_y - y) <= VISITED
            if replan or place < 0:
                _choose_place(memory, seed, step, x, y, heading, cuts_corners)
        elif replan:
            points[_PLANNED, 0], points[_PLANNED, 1] = points[_TARGET, 0], points[_TARGET, 1]
            spared = CONTACT if numbers[_MODE] == CHASE else 0.0
            if not _go(memory, x, y, number, points[_TARGET, 0], points[_TARGET, 1], spared, cuts_corners):
                numbers[_MODE], numbers[_PLACE], replan = EXPLORE, -1, True
                continue
        primitive, index = follow(x, y, number, memory.waypoints[: numbers[_COUNT]], numbers[_INDEX])
        numbers[_INDEX] = index
        if primitive != STAY or attempt == 1:
            break
        # The path is at its end: whatever it led to is not there.
        numbers[_MODE], numbers[_PLACE], replan = EXPLORE, -1, True
    if primitive == STAY:  # no place can be reached: look around, and back out of what refused a move
        primitive = BACKWARD if numbers[_BUMPED] > step and step % 2 == 0 else LEFT
    numbers[_PRIMITIVE] = primitive
    return primitive
