"""The driver as a pure core: places the robots at the start of a game, then carries out both commands of every step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from schemas import PRIMITIVES, ROBOTS, Command, Episode, Layout, Motion, Tick, Track
from services.robot.declaration import DECLARATION
from services.robot.driven_robot import DrivenRobot
from services.robot.motion_control import Ended, Target
from services.robot.placing import Arena, Placing
from services.robot.pose_estimate import Place, wrapped
from services.robot.settings import NO_PORT, RobotSettings
from vantage.service import SECOND, Arrived, Captured, Publish, Received, Send, Unexpected, Woken
from vantage.world.arena import BACKWARD, FORWARD, STAY
from vantage.world.game import move_both
from vantage.world.layout import ImpossibleLayout, boxes_of
from vantage.world.motion import heading_number, heading_radians
from vantage.world.start import draw_start

_NUMBER_OF_PRIMITIVE = {name: number for number, name in enumerate(PRIMITIVES)}

SIGHT = SECOND // 2
"""ns: an older track does not tell where a robot is."""
PLANNING = SECOND
"""ns between two attempts to find a way to a start."""
ATTEMPTS = 8
"""Attempts to bring the robots to their starts, before the driver gives up."""
_RESTARTED = "the driver was restarted while this step may have been under way; where the robot is, it stays"


class _Phase(Enum):
    IDLE = "outside a game"
    LISTENING = "joining a game under way"
    PLACING = "driving to the starts"
    PLAYING = "carrying out commands"


@dataclass(slots=True)
class _Move:
    """What a robot was told, when, and where that leads: x, y (m), heading number."""

    primitive: int
    begun: int
    reference: tuple[float, float, float]


class RobotCore:
    """See module. References are where robots ought to be: x, y in m and the heading in units of 10 degrees."""

    declaration = DECLARATION

    def __init__(self, settings: RobotSettings | None = None) -> None:
        self._settings = settings or RobotSettings()
        self._robots = {robot: DrivenRobot(robot, self._settings) for robot in ROBOTS if self._settings.port_of(robot) != NO_PORT}
        self._tracks: dict[str, Track] = {}
        self._layout: Layout | None = None
        self._episode: Episode | None = None
        self._phase = _Phase.IDLE
        self._wake: int | None = None
        self._step: int | None = 0
        self._commands: dict[str, int] = {}
        self._references: dict[str, tuple[float, float, float]] = {}
        self._moves: dict[str, _Move] = {}
        self._placing: Placing | None = None
        self._placing_since = 0
        self._attempts = 0
        self._trouble = ""
        self._now = 0

    @property
    def trouble(self) -> str:
        """What is wrong now, for people."""
        troubles = [robot.trouble(self._now) for robot in self._robots.values()]
        return "; ".join(text for text in (*troubles, self._trouble) if text)

    def wake_at(self) -> int | None:
        wakes = [robot.wake_at() for robot in self._robots.values()]
        if self._wake is not None:
            wakes.append(self._wake)
        return min(wakes, default=None)

    def step(self, received: Received, now: int) -> Sequence[Send]:
        self._now = now
        if isinstance(received, Captured):
            robot = self._robots[received.device]
            return self._with_end(received.device, *robot.hear(received, now), now)
        if isinstance(received, Woken):
            return self._on_time(now)
        if not isinstance(received, Arrived):
            return ()
        message, name = received.message, received.key.partition("/")[0]
        if isinstance(message, Track):
            return self._on_track(name, message, now)
        if isinstance(message, Command):
            return self._on_command(name, message, now)
        if isinstance(message, Tick):
            return self._on_tick(message, now)
        if isinstance(message, Layout):
            self._layout = message
            return self._go_on(now)
        if isinstance(message, Episode):
            return self._on_episode(message, now)
        return ()

    def _on_time(self, now: int) -> Sequence[Send]:
        sends: list[Send] = []
        for name, robot in self._robots.items():
            if robot.wake_at() <= now:
                sends.extend(self._with_end(name, *robot.advance(now), now))
        if self._wake is not None and self._wake <= now:
            self._wake = None
            if self._phase is _Phase.LISTENING:
                sends.extend(self._join(now))
            else:
                sends.extend(self._go_on(now))
        return sends

    def _on_track(self, name: str, track: Track, now: int) -> Sequence[Send]:
        if track.seen:
            self._tracks[name] = track
        if name in self._robots:
            self._robots[name].see(track, now)
        return ()

    def _on_episode(self, episode: Episode, now: int) -> Sequence[Send]:
        known = self._episode is not None and self._episode.episode == episode.episode
        if episode.phase == "setup":
            return self._set_up(episode, now)
        if episode.phase == "running":
            if not known:
                self._reset(episode, _Phase.LISTENING)
                self._step = None
                self._wake = now + int(self._settings.settle * SECOND)
            return ()
        if not known:
            return ()
        self._reset(None, _Phase.IDLE)
        return [send for robot in self._robots.values() for send in robot.halt(now)]

    def _reset(self, episode: Episode | None, phase: _Phase) -> None:
        self._episode, self._phase = episode, phase
        self._wake, self._step = None, 0
        self._commands.clear()
        self._references.clear()
        self._moves.clear()
        self._placing = None
        self._attempts = 0
        self._trouble = ""

    def _set_up(self, episode: Episode, now: int) -> Sequence[Send]:
        self._reset(episode, _Phase.PLACING)
        self._placing_since = now
        sends: list[Send] = []
        for robot in self._robots.values():
            sends.extend(robot.clear(now))
            sends.extend(robot.halt(now))
        return [*sends, *self._go_on(now)]

    def _go_on(self, now: int) -> Sequence[Send]:
        """Do what waited for a layout, a track, or time."""
        if self._phase is _Phase.PLACING and (self._placing is None or self._placing.moving is None):
            return self._place(now)
        if self._phase is _Phase.PLAYING:
            return self._carry_out_if_complete(now)
        return ()

    # Placing

    def _place(self, now: int) -> Sequence[Send]:
        """Begin the next drive to a start, or say that all robots are there."""
        layout, episode = self._layout, self._episode
        if episode is None or layout is None or layout.episode != episode.episode or not self._robots:
            return ()
        if self._placing is None:
            rules = episode.rules
            boxes, distances = boxes_of(layout), (rules.start_distance_minimum, rules.start_distance_maximum)
            try:
                starts = draw_start(boxes, layout.width, layout.depth, episode.seed, *distances)
            except ImpossibleLayout as error:
                return self._give_up(str(error), now)
            drawn = dict(zip(ROBOTS, starts, strict=True))
            self._references.update({robot: drawn[robot] for robot in self._robots})
            self._placing = Placing(Arena(boxes, layout.width, layout.depth), {robot: drawn[robot] for robot in self._robots})
        if self._placing.done:
            self._phase = _Phase.PLAYING
            self._trouble = ""
            return [self._motion(robot, STAY, Ended("completed", *self._errors_of(robot)), 0, now) for robot in self._robots]
        places = self._places(now)
        missing = [robot for robot in ROBOTS if robot not in places]
        trouble = f"the overhead camera does not see {' and '.join(missing)}" if missing else self._placing.plan(places)
        if trouble:
            return self._try_later(trouble, now)
        self._trouble = ""
        return self._begin_line(now)

    def _begin_line(self, now: int) -> Sequence[Send]:
        assert self._placing is not None and self._placing.moving is not None
        line = self._placing.next_line()
        assert line is not None
        robot = self._robots[self._placing.moving]
        robot.begin(line, now, self._settings.control.placing_speed)
        return robot.advance(now)[0]

    def _on_line_end(self, ended: Ended, now: int) -> Sequence[Send]:
        assert self._placing is not None
        if ended.result == "completed":
            self._placing.arrived()
            return self._begin_line(now) if self._placing.moving is not None else self._place(now)
        name = self._placing.moving
        self._placing.interrupted()
        return self._try_later(f"robot {name} did not get to its start: {ended.result}, {ended.reason}", now)

    def _try_later(self, trouble: str, now: int) -> Sequence[Send]:
        self._trouble = trouble
        self._attempts += 1
        if self._attempts < ATTEMPTS:
            self._wake = now + PLANNING
            return ()
        return self._give_up(trouble, now)

    def _give_up(self, trouble: str, now: int) -> Sequence[Send]:
        """No poses follow what was stopped, so the referee gives this game up, with our trouble as the reason."""
        self._trouble = trouble
        self._phase = _Phase.PLAYING
        stopped = Ended("stopped", 0.0, 0.0, trouble[:200])
        return [self._motion(robot, STAY, stopped, 0, now) for robot in self._robots]

    def _places(self, now: int) -> dict[str, Place]:
        """Return where the robots are that were seen lately."""
        places = {}
        for robot, track in self._tracks.items():
            if now - track.stamp <= SIGHT:
                known = self._robots[robot].control.estimate.place if robot in self._robots else None
                places[robot] = known or Place(track.x, track.y, track.heading)
        return places

    # Playing

    def _on_command(self, name: str, command: Command, now: int) -> Sequence[Send]:
        self._check(f"{name}/command", command.episode, command.step)
        if name in self._commands:
            raise Unexpected(f"a second {name}/command for step {command.step}")
        self._commands[name] = _NUMBER_OF_PRIMITIVE[command.primitive]
        return self._carry_out_if_complete(now)

    def _on_tick(self, tick: Tick, now: int) -> Sequence[Send]:
        if not tick.late and self._episode is not None and tick.episode == self._episode.episode:
            if self._phase is _Phase.LISTENING and (self._step is None or tick.step > self._step):
                self._check("tick", tick.episode, tick.step)
            return ()  # a tick that opens a step may come after the commands it led to
        self._check("tick", tick.episode, tick.step)
        for robot in tick.late:
            self._commands.setdefault(robot, STAY)
        return self._carry_out_if_complete(now)

    def _check(self, what: str, episode: int, step: int) -> None:
        """Refuse what does not belong to the step at which the robots stand; who joins a game learns the step from it."""
        playing = self._episode is not None and self._episode.episode == episode
        if playing and (self._step is None or (self._phase is _Phase.LISTENING and step > self._step)):
            self._step = step
            self._commands.clear()
        if not playing or self._step != step or self._phase in (_Phase.IDLE, _Phase.PLACING):
            raise Unexpected(f"{what} of episode {episode} step {step} while {self._phase.value}, step {self._step}")

    def _carry_out_if_complete(self, now: int) -> Sequence[Send]:
        if self._phase is not _Phase.PLAYING or len(self._commands) < len(ROBOTS) or self._moves or self._layout is None:
            return ()
        anchored = {robot: self._references.get(robot) or self._anchor(robot) for robot in ROBOTS}
        primitives = np.array([self._commands[robot] for robot in ROBOTS], np.int64)
        self._commands.clear()
        # A robot that was never seen stands nowhere: the other one is judged without it.
        poses = np.array([anchored[robot] or (np.nan, np.nan, 0.0) for robot in ROBOTS], np.float64)
        wanted, moved = np.empty((2, 3)), np.empty(2, np.bool_)
        layout = self._layout
        move_both(boxes_of(layout), layout.width, layout.depth, poses, primitives, wanted, moved)
        for index, robot in enumerate(ROBOTS):
            if robot in self._robots:
                x, y, heading = wanted[index].tolist()
                self._moves[robot] = _Move(int(primitives[index]), now, (x, y, heading))
        sends: list[Send] = []
        for index, robot in enumerate(ROBOTS):
            if robot not in self._robots:
                continue
            if anchored[robot] is None:
                sends.extend(self._end_move(robot, Ended("lost", 0.0, 0.0, "never seen by the overhead camera"), now))
            elif not moved[index]:
                self._references[robot] = self._moves[robot].reference
                error = self._errors_of(robot)
                sends.extend(self._end_move(robot, Ended("refused", *error, "it would have collided"), now, refused=True))
            else:
                self._robots[robot].begin(self._target_of(self._moves[robot]), now)
                sends.extend(self._with_end(robot, *self._robots[robot].advance(now), now))
        return sends

    def _target_of(self, move: _Move) -> Target:
        x, y, heading = move.reference
        gear = {FORWARD: 1, BACKWARD: -1}.get(move.primitive, 0)
        control = self._settings.control
        return Target(x, y, heading_radians(int(heading)), gear, True, control.distance_tolerance, control.patience)

    def _with_end(self, robot: str, sends: list[Send], ended: Ended | None, now: int) -> Sequence[Send]:
        if ended is None:
            return sends
        if self._phase is _Phase.PLACING:
            return [*sends, *self._on_line_end(ended, now)]
        return [*sends, *(self._end_move(robot, ended, now) if robot in self._moves else ())]

    def _end_move(self, robot: str, ended: Ended, now: int, refused: bool = False) -> Sequence[Send]:
        """Report what came of a command; what did not complete goes on from where the robot is tracked."""
        assert self._step is not None
        move = self._moves.pop(robot)
        if ended.result == "completed" or refused:
            self._references[robot] = move.reference
        else:
            self._references.pop(robot, None)
        motion = self._motion(robot, move.primitive, ended, self._step + 1, now, now - move.begun)
        if not self._moves:
            self._step += 1
        return [motion]

    def _motion(self, robot: str, primitive: int, ended: Ended, step: int, now: int, elapsed: int | None = None) -> Publish:
        assert self._episode is not None
        battery = self._robots[robot].link.battery
        return Publish(
            f"{robot}/motion",
            Motion(
                stamp=now,
                episode=self._episode.episode,
                step=step,
                primitive=PRIMITIVES[primitive],
                result=ended.result,
                distance_error=ended.distance_error,
                heading_error=ended.heading_error,
                elapsed=(now - self._placing_since if elapsed is None else elapsed) / SECOND,
                battery=None if battery is None else min(battery, 100.0),
                reason=ended.reason[:200],
            ),
        )

    def _anchor(self, robot: str) -> tuple[float, float, float] | None:
        """Return the reference of a robot that has none: where it is tracked, its heading to the nearest 10 degrees."""
        place = self._robots[robot].control.estimate.place if robot in self._robots else None
        if place is None and (track := self._tracks.get(robot)) is not None:
            place = Place(track.x, track.y, track.heading)
        return None if place is None else (place.x, place.y, float(heading_number(place.heading)))

    def _errors_of(self, robot: str) -> tuple[float, float]:
        """Return distance (m) and heading error (rad) of a robot's tracked pose from its reference."""
        place = self._robots[robot].control.estimate.place
        x, y, heading = self._references[robot]
        if place is None:
            return 0.0, 0.0
        return math.hypot(place.x - x, place.y - y), wrapped(place.heading - heading_radians(int(heading)))

    def _join(self, now: int) -> Sequence[Send]:
        """Go on with a game that a crashed driver left behind: what may have been begun is not done again."""
        self._phase = _Phase.PLAYING
        if len(self._commands) < len(ROBOTS) or self._step is None:
            return ()
        primitives, self._commands = self._commands, {}
        interrupted = Ended("timed-out", 0.0, 0.0, _RESTARTED)
        motions = [self._motion(robot, primitives[robot], interrupted, self._step + 1, now, 0) for robot in self._robots]
        self._step += 1
        return motions
