"""The rules of the game as a pure core: sets games up, keeps the step clock, judges the catch, gives up on stalled games."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import cast

from schemas import REASON_LIMIT, ROBOTS, Command, Control, Episode, Health, Layout, Players, Pose, Robot, Rules, Tick
from services.referee.declaration import DECLARATION
from vantage.service import SECOND, Arrived, Changed, Publish, Received, Send, Unexpected, Woken
from vantage.world.arena import CATCH_TOLERANCE

SHARE = 110
"""Letters of an abort's reason that one service's troubles may take."""

_RESTARTED = "the referee was restarted; the setup of this game has its seed and rules"


@dataclass(frozen=True)
class RefereeSettings:
    """How games are started and how long the referee waits for the players."""

    autoplay: bool = False
    """Start games without being asked, as soon as every required service is alive."""
    games: int = 0
    """How many games autoplay plays; 0 = without end."""
    seed: int = 1
    """Seed of episode 1 in autoplay; episode n uses seed + n - 1."""
    first_episode: int = 1
    """Number of the first episode."""
    rules: Rules = field(default_factory=Rules)
    """Rules of the games of autoplay."""
    players: Players = field(default_factory=Players)
    """Who plays in autoplay."""
    required: tuple[str, ...] = DECLARATION.heeds
    """Services that must be alive before a game is set up; `a|b`: one of the two."""
    settle: float = 0.5
    """Seconds to listen after the start, to hear of a game that a crashed referee left behind."""
    pause: float = 2.0
    """Seconds between games in real time."""
    setup_patience: float = 10.0
    """Seconds to wait for the first poses of a game, since the world last said how the table stands (`layout`): a real table
    says it again and again while robots drive to their starts."""
    setup_limit: float = 180.0
    """Seconds that a set-up may take in all, however often the layout is said."""
    planning_patience: float = 30.0
    """Seconds to wait for the first commands: the hider paints its value map in this time."""
    command_patience: float = 1.0
    """Seconds after which a robot without a command stays where it is (real time only)."""
    step_patience: float = 3.0
    """Seconds to wait for the poses after a step before the game is aborted."""


class _Phase(Enum):
    LISTENING = "listening for a game left behind"
    IDLE = "waiting for a game to be asked for, or for a service"
    SETUP = "waiting for the first poses"
    COMMANDS = "waiting for commands"
    POSES = "waiting for the step to be executed"
    PACING = "waiting for the next tick"
    PAUSE = "between games"


class RefereeCore:
    """See module. One event in, messages out; all times in ns."""

    def __init__(self, settings: RefereeSettings | None = None) -> None:
        self._settings = settings or RefereeSettings()
        self.declaration = replace(DECLARATION, heeds=self._settings.required)
        self._phase = _Phase.LISTENING
        self._wake: int | None = 0
        self._alive: set[str] = set()
        self._number = self._settings.first_episode - 1
        self._left_behind = 0
        self._games_left: int | None = 0
        if self._settings.autoplay:
            self._games_left = None if self._settings.games == 0 else self._settings.games
        self._rules = self._settings.rules
        self._players = self._settings.players
        self._seed_of_first = self._settings.seed
        self._first_number: int | None = self._settings.first_episode  # None: the next game is the first
        self._step = 0
        self._poses: dict[str, Pose] = {}
        self._commanded: set[str] = set()
        self._ticked_at = 0
        self._set_up_at = 0
        self._listening_since: int | None = None
        self._trouble_of_world: dict[str, str] = {}

    def wake_at(self) -> int | None:
        return self._wake

    def step(self, received: Received, now: int) -> Sequence[Send]:
        if isinstance(received, Arrived):
            message = received.message
            robot = received.key.partition("/")[0]
            if self._phase is _Phase.LISTENING and isinstance(message, Pose | Command):
                self._left_behind = max(self._left_behind, message.episode)
                return ()
            if isinstance(message, Pose):
                return self._on_pose(robot, message, now)
            if isinstance(message, Command):
                return self._on_command(robot, message, now)
            if isinstance(message, Control):
                return self._on_control(message, now)
            if isinstance(message, Layout) and self._phase is _Phase.SETUP and message.episode == self._number:
                limit = self._set_up_at + int(self._settings.setup_limit * SECOND)
                self._wake = min(now + int(self._settings.setup_patience * SECOND), limit)
            elif isinstance(message, Health):
                self._trouble_of_world[message.service] = message.reason
            return ()
        if isinstance(received, Changed):
            (self._alive.add if received.alive else self._alive.discard)(received.service)
            return self._begin_if_possible(now) if self._phase is _Phase.IDLE else ()
        if isinstance(received, Woken):
            return self._on_time(now)
        return ()

    def _on_time(self, now: int) -> Sequence[Send]:
        if self._phase is _Phase.LISTENING:
            if self._listening_since is None:
                self._listening_since = now
                self._wake = now + int(self._settings.settle * SECOND)
                return ()
            return self._finish_listening(now)
        if self._wake is None or now < self._wake:
            return ()
        self._wake = None
        if self._phase is _Phase.PAUSE:
            self._phase = _Phase.IDLE
            return self._begin_if_possible(now)
        if self._phase is _Phase.SETUP:
            return self._abort(self._blame(f"no poses {(now - self._set_up_at) / SECOND:.0f} s after the setup"), now)
        if self._phase is _Phase.PACING:
            return self._tick(self._step, now)
        if self._phase is _Phase.COMMANDS:
            late = cast("tuple[Robot, ...]", tuple(robot for robot in ROBOTS if robot not in self._commanded))
            if self._rules.step_period == 0.0 or self._step == 0:
                return self._abort(f"no command from the {' or the '.join(late)} for step {self._step}", now)
            self._wait_for_poses(now)
            return (Publish("tick", Tick(stamp=now, episode=self._number, step=self._step, late=late)),)
        if self._phase is _Phase.POSES:
            return self._abort(self._blame(f"step {self._step} was not executed within {self._settings.step_patience:g} s"), now)
        return ()

    def _finish_listening(self, now: int) -> Sequence[Send]:
        self._phase = _Phase.IDLE
        self._wake = None
        sends: list[Send] = []
        if self._left_behind > self._number:
            self._number = self._left_behind
            sends.append(self._episode("aborted", now, reason=_RESTARTED))
        sends.extend(self._begin_if_possible(now))
        return sends

    def _on_control(self, control: Control, now: int) -> Sequence[Send]:
        sends: list[Send] = []
        if self._phase not in (_Phase.LISTENING, _Phase.IDLE, _Phase.PAUSE):
            sends.extend(self._abort("stopped on request" if control.action == "stop" else "another game was asked for", now))
        if control.action == "stop":
            self._games_left = 0
        else:
            self._games_left = None if control.games == 0 else control.games
            self._rules = control.rules
            self._players = control.players
            self._seed_of_first = control.seed
            self._first_number = None
        if self._phase is not _Phase.LISTENING:
            self._phase = _Phase.IDLE
            self._wake = None
            sends.extend(self._begin_if_possible(now))
        return sends

    def _begin_if_possible(self, now: int) -> Sequence[Send]:
        if self._games_left == 0 or any(self._alive.isdisjoint(names.split("|")) for names in self._settings.required):
            return ()
        if self._games_left is not None:
            self._games_left -= 1
        self._number += 1
        if self._first_number is None:
            self._first_number = self._number
        self._step = 0
        self._poses.clear()
        self._phase = _Phase.SETUP
        self._set_up_at = now
        self._wake = now + int(self._settings.setup_patience * SECOND)
        return (self._episode("setup", now),)

    def _on_pose(self, robot: str, pose: Pose, now: int) -> Sequence[Send]:
        expected = {_Phase.SETUP: 0, _Phase.COMMANDS: self._step + 1, _Phase.POSES: self._step + 1}.get(self._phase)
        if pose.episode != self._number or pose.step != expected:
            raise Unexpected(f"{robot}/pose of episode {pose.episode} step {pose.step} while {self._phase.value}")
        self._poses[robot] = pose
        if len(self._poses) < len(ROBOTS):
            return ()
        hider, seeker = self._poses["hider"], self._poses["seeker"]
        self._poses.clear()
        if self._phase is _Phase.SETUP:
            return [self._episode("running", now), *self._tick(0, now)]
        reached = self._step + 1
        distance = math.hypot(hider.x - seeker.x, hider.y - seeker.y)
        if self._rules.catching and distance <= self._rules.catch_distance + CATCH_TOLERANCE:
            return self._end("caught", reached, now)
        if reached >= self._rules.maximum_steps:
            return self._end("survived", reached, now)
        due = self._ticked_at + int(self._rules.step_period * SECOND)
        if now >= due:
            return self._tick(reached, now)
        self._phase = _Phase.PACING
        self._step = reached
        self._wake = due
        return ()

    def _on_command(self, robot: str, command: Command, now: int) -> Sequence[Send]:
        if command.episode == self._number and command.step < self._step:
            return ()  # the poses that followed from it came first: publishers are not ordered among each other
        if self._phase is not _Phase.COMMANDS or command.episode != self._number or command.step != self._step:
            raise Unexpected(f"{robot}/command for episode {command.episode} step {command.step} while {self._phase.value}")
        self._commanded.add(robot)
        if len(self._commanded) == len(ROBOTS):
            self._wait_for_poses(now)
        return ()

    def _wait_for_poses(self, now: int) -> None:
        self._phase = _Phase.POSES
        self._wake = now + int(self._settings.step_patience * SECOND)

    def _tick(self, step: int, now: int) -> Sequence[Send]:
        self._step = step
        self._commanded.clear()
        self._phase = _Phase.COMMANDS
        self._ticked_at = now
        patience = self._settings.planning_patience if step == 0 else self._settings.command_patience
        if self._rules.step_period == 0.0:
            patience = self._settings.planning_patience
        self._wake = now + int(patience * SECOND)
        return (Publish("tick", Tick(stamp=now, episode=self._number, step=step)),)

    def _end(self, outcome: str, step: int, now: int) -> Sequence[Send]:
        self._step = step
        reason = f"caught at step {step}" if outcome == "caught" else f"not caught in {step} steps"
        episode = self._episode("ended", now, outcome=outcome, caught_step=step if outcome == "caught" else None, reason=reason)
        self._rest(now)
        return (episode,)

    def _abort(self, reason: str, now: int) -> Sequence[Send]:
        episode = self._episode("aborted", now, reason=reason)
        self._rest(now)
        return (episode,)

    def _blame(self, reason: str) -> str:
        """Return a reason with who is not alive, and what those who embody the robots last said: they owe the answer."""
        gone = [names for names in self._settings.required if self._alive.isdisjoint(names.split("|"))]
        troubles = [f"{names.replace('|', ' or ')} is not alive" for names in gone]
        for service, trouble in self._trouble_of_world.items():
            if trouble and service in self._alive:
                said = f"{service}: {trouble}"
                troubles.append(said if len(said) <= SHARE else said[: SHARE - 3] + "...")
        return "; ".join([reason, *troubles])[:REASON_LIMIT]

    def _rest(self, now: int) -> None:
        self._phase = _Phase.PAUSE
        self._wake = now + (int(self._settings.pause * SECOND) if self._rules.step_period > 0 else 0)

    def _episode(
        self, phase: str, now: int, *, outcome: str = "undecided", caught_step: int | None = None, reason: str = ""
    ) -> Publish:
        return Publish(
            "episode",
            Episode(
                stamp=now,
                episode=self._number,
                step=self._step,
                seed=self._seed_of_first + (0 if self._first_number is None else self._number - self._first_number),
                phase=phase,  # type: ignore[arg-type]
                rules=self._rules,
                players=self._players,
                outcome=outcome,  # type: ignore[arg-type]
                caught_step=caught_step,
                reason=reason,
            ),
        )
