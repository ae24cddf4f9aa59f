"""One step of a game after the other: both commands become two motions at once, by the very rule of the simulation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from schemas import PRIMITIVES, REASON_LIMIT, ROBOTS, Layout, Motion
from services.robot.driven_robot import DrivenRobot
from services.robot.motion_control import Ended, Target
from services.robot.pose_estimate import Place
from services.robot.settings import Control
from vantage.printable import shortened
from vantage.service import SECOND, Publish, Send
from vantage.world.arena import BACKWARD, FORWARD, STAY
from vantage.world.game import move_both
from vantage.world.layout import boxes_of
from vantage.world.motion import heading_number, heading_radians

Reference = tuple[float, float, float]
"""Where a robot ought to be: x, y (m) and heading number."""

_RESTARTED = "the driver was restarted while this step may have been under way; the robot stays where it is"


@dataclass(slots=True)
class _Move:
    """What a robot was told, when, and where that leads."""

    primitive: int
    begun: int
    reference: Reference


class Stepping:
    """See module.

    Args:
        robots: those driven from here; the others are only stepped around.
        control: tolerances and patience of a motion.
        where: where a robot was tracked last; None when it never was.

    Attributes:
        step: at which the robots stand; None: not known yet.
        commands: of this step, by robot; kept until its motions have ended, so that a late one is known for what it is.
    """

    def __init__(self, robots: Mapping[str, DrivenRobot], control: Control, where: Callable[[str], Place | None]) -> None:
        self._robots = robots
        self._control = control
        self._where = where
        self._references: dict[str, Reference] = {}
        self._moves: dict[str, _Move] = {}
        self._episode = 0
        self.step: int | None = 0
        self.commands: dict[str, int] = {}

    def begin(self, episode: int, step: int | None) -> None:
        """Turn to an episode, forgetting what was."""
        self._episode, self.step = episode, step
        self.commands.clear()
        self._references.clear()
        self._moves.clear()

    def started(self, references: Mapping[str, Reference], since: int, now: int) -> list[Send]:
        """Report robots that stand at their starts."""
        self._references.update(references)
        ended = {robot: Ended("completed", *self._errors(robot)) for robot in references}
        return [self._motion(robot, STAY, ended[robot], 0, now, now - since) for robot in references]

    def not_started(self, reason: str, since: int, now: int) -> list[Send]:
        """Report robots that did not get to their starts: no poses follow, so the referee gives this game up."""
        stopped = Ended("stopped", 0.0, 0.0, reason)
        return [self._motion(robot, STAY, stopped, 0, now, now - since) for robot in self._robots]

    def interrupted(self, now: int) -> list[Send]:
        """Report what a crashed driver may have begun, without doing it again, if both commands of the step are there."""
        if len(self.commands) < len(ROBOTS) or self.step is None:
            return []
        ended = Ended("timed-out", 0.0, 0.0, _RESTARTED)
        motions = [self._motion(robot, self.commands[robot], ended, self.step + 1, now, 0) for robot in self._robots]
        self.commands.clear()
        self.step += 1
        return list(motions)

    def carry_out(self, layout: Layout, now: int) -> Sequence[Send]:
        """Begin the step's motions once both commands are there and nothing is under way."""
        if len(self.commands) < len(ROBOTS) or self._moves or not self._robots:
            return ()
        anchored = {robot: self._references.get(robot) or self._anchor(robot) for robot in ROBOTS}
        primitives = np.array([self.commands[robot] for robot in ROBOTS], np.int64)
        # A robot that was never seen stands nowhere: the other one is judged without it.
        poses = np.array([anchored[robot] or (np.nan, np.nan, 0.0) for robot in ROBOTS], np.float64)
        wanted, moved = np.empty((2, 3)), np.empty(2, np.bool_)
        move_both(boxes_of(layout), layout.width, layout.depth, poses, primitives, wanted, moved)
        refused = Ended("refused", 0.0, 0.0, "not begun: it would have collided")
        unseen = Ended("lost", 0.0, 0.0, "never seen by the overhead camera")
        for index, robot in enumerate(ROBOTS):
            if robot in self._robots:
                x, y, heading = wanted[index].tolist()
                self._moves[robot] = _Move(int(primitives[index]), now, (x, y, heading))
        sends: list[Send] = []
        for index, robot in enumerate(ROBOTS):
            if robot not in self._robots:
                continue
            if anchored[robot] is None:
                sends.extend(self.ended(robot, unseen, now))
            elif not moved[index]:
                sends.extend(self.ended(robot, refused, now))
            else:
                self._robots[robot].begin(self._target_of(self._moves[robot]), now)
                lines, ended = self._robots[robot].advance(now)
                sends.extend(lines)
                sends.extend(self.ended(robot, ended, now) if ended is not None else ())
        return sends

    def ended(self, robot: str, ended: Ended, now: int) -> list[Send]:
        """Report what came of a command. What did not complete goes on from where the robot is tracked then."""
        move = self._moves.pop(robot, None)
        if move is None or self.step is None:
            return []
        if ended.result in ("completed", "refused"):
            self._references[robot] = move.reference
        else:
            self._references.pop(robot, None)
        if ended.result == "refused":
            ended = Ended("refused", *self._errors(robot), ended.reason)
        motion = self._motion(robot, move.primitive, ended, self.step + 1, now, now - move.begun)
        if not self._moves:
            self.step += 1
            self.commands.clear()
        return [motion]

    def _target_of(self, move: _Move) -> Target:
        x, y, heading = move.reference
        gear = {FORWARD: 1, BACKWARD: -1}.get(move.primitive, 0)
        return Target(x, y, heading_radians(int(heading)), gear, True, self._control.distance_tolerance, self._control.patience)

    def _anchor(self, robot: str) -> Reference | None:
        """Return the reference of a robot that has none: where it is tracked, its heading to the nearest 10 degrees."""
        place = self._where(robot)
        return None if place is None else (place.x, place.y, float(heading_number(place.heading)))

    def _errors(self, robot: str) -> tuple[float, float]:
        """Return distance (m) and heading error (rad) of a robot's tracked pose from its reference."""
        place = self._where(robot)
        if place is None:
            return 0.0, 0.0
        x, y, heading = self._references[robot]
        turn = math.remainder(place.heading - heading_radians(int(heading)), math.tau)
        return min(math.hypot(place.x - x, place.y - y), 100.0), turn

    def _motion(self, robot: str, primitive: int, ended: Ended, step: int, now: int, elapsed: int) -> Send:
        battery = self._robots[robot].link.battery
        return Publish(
            f"{robot}/motion",
            Motion(
                stamp=now,
                episode=self._episode,
                step=step,
                primitive=PRIMITIVES[primitive],
                result=ended.result,
                distance_error=ended.distance_error,
                heading_error=ended.heading_error,
                elapsed=max(elapsed, 0) / SECOND,
                battery=battery,
                reason=shortened(ended.reason, REASON_LIMIT),
            ),
        )
