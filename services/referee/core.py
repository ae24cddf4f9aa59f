"""The rules of the game as a pure core: sets games up, keeps the step clock, judges the catch, gives up on stalled games.

What people ask for (`control`):

* `start`: aborts the game under way; games are played as asked. Its `request` is a random name of these games: they carry it as
  `Episode.request`, by which whoever asked knows them, whatever their numbers, seeds and times; and a request that comes again
  (its sender saw no game, or the referee was restarted) starts nothing if it is known. Games with an `owner` belong to that
  participant: when it leaves the bus and is not back within `owner_patience`, the referee publishes a `stop` of their request,
  with the reason, and obeys it like any other. Games without an owner go on until they are played or stopped.
* `stop`: aborts the game under way, and none follows. With a `request` it stops the games of that request only: a late one does
  not stop the games that somebody else has asked for since. Its `reason` becomes that of the aborted game.
* `pause` in a running game: said at once (`Episode`, `paused`). The step under way is finished, with the usual patience, and the
  catch judged; then there is no tick until `resume`, which is said too. In the set-up: the robots come to their starts, and the
  game begins (`running`, `paused`) without its first tick. Between games: the next one is not set up; nothing is said. A game
  that ends or is aborted while paused says so with `paused`, and the next one waits for `resume`, `start` or `stop`. A pause
  makes no sense where no game is played and none is to follow.
* `resume`: the tick that is due comes at once. Its `speed`, and `seek`, are for replays.
* `discard`: the running game is aborted; of one that is over the message on the log is the record, and nothing is said.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

from schemas import ROBOTS, Command, Control, Health, Layout, Pose, Robot, Tick
from services.referee import reasons
from services.referee.blame import Troubles
from services.referee.declaration import DECLARATION, OWNERS, WORLD
from services.referee.drivers import HUMAN, HiderDrivers
from services.referee.owner import Owner
from services.referee.patience import Patience
from services.referee.phase import Phase
from services.referee.series import GamePhase, Series
from services.referee.settings import RefereeSettings
from vantage.service import SECOND, Arrived, Changed, Publish, Received, Send, Unexpected, Woken
from vantage.world.arena import CATCH_TOLERANCE

__all__ = ["RefereeCore", "RefereeSettings"]

KNOWN_REQUESTS = 256
"""Requests that are remembered, so that none is played twice."""
SET_UP_SPACING = SECOND // 10
"""ns between the set-ups of games that are replaced before the world has answered: however often games are asked for, the world
has no backlog of set-ups."""


class RefereeCore:
    """See module. One event in, messages out; all times in ns."""

    def __init__(self, settings: RefereeSettings | None = None) -> None:
        self._settings = settings or RefereeSettings()
        self.declaration = replace(DECLARATION, heeds=self._settings.required)
        self._phase = Phase.LISTENING
        self._wake: int | None = 0
        self._alive: set[str] = set()
        self._number = self._settings.first_episode - 1
        self._left_behind = 0
        self._series = Series(self._settings)
        self._step = 0
        self._poses: dict[str, Pose] = {}
        self._commanded: set[str] = set()
        self._ticked_at = 0
        self._commanded_at = 0  # when both commands of the step had come
        self._due = 0  # when the next tick comes
        self._deadline = 0  # of the commands
        self._held = False  # paused
        self._drivers = HiderDrivers(self._settings.required, int(self._settings.driver_patience * SECOND))
        self._driver_until: int | None = None  # until when the set-up waits for who drives the hider
        self._set_up_at = 0
        self._unanswered = False  # the last game was given up before the world had set it up
        self._listening_since: int | None = None
        self._troubles = Troubles(self._settings.required)
        self._patience = Patience(int(self._settings.outage_patience * SECOND))
        self._owner = Owner(int(self._settings.owner_patience * SECOND))
        self._known: deque[str] = deque(maxlen=KNOWN_REQUESTS)

    def wake_at(self) -> int | None:
        return min((time for time in (self._wake, self._owner.gone_at) if time is not None), default=None)

    def step(self, received: Received, now: int) -> Sequence[Send]:
        if isinstance(received, Arrived):
            message = received.message
            robot = received.key.partition("/")[0]
            if self._phase is Phase.LISTENING and isinstance(message, Pose | Command):
                self._left_behind = max(self._left_behind, message.episode)
                return ()
            if isinstance(message, Pose):
                return self._on_pose(robot, message, now)
            if isinstance(message, Command):
                return self._on_command(robot, message, now)
            if isinstance(message, Control):
                return self._on_control(message, now)
            if isinstance(message, Layout) and self._phase is Phase.SETUP and message.episode == self._number:
                limit = self._set_up_at + int(self._settings.setup_limit * SECOND)
                self._wake = min(now + int(self._settings.setup_patience * SECOND), limit)
            elif isinstance(message, Health):
                return self._on_health(message, now)
            return ()
        if isinstance(received, Changed):
            (self._alive.add if received.alive else self._alive.discard)(received.service)
            self._owner.change(received.service, received.alive, now)
            self._troubles.change(received.service, received.alive)
            if received.service in WORLD:
                self._patience.change(received.service, received.alive, now)
            return self._begin_if_possible(now) if self._phase is Phase.IDLE else ()
        if isinstance(received, Woken):
            return [*self._stop_for_owner(now), *self._on_time(now)]
        return ()

    def _stop_for_owner(self, now: int) -> Sequence[Send]:
        """Stop the games of a participant that has left the bus, by publishing a `stop` on `control`."""
        if self._owner.gone_at is None or now < self._owner.gone_at:
            return ()
        self._owner.end()
        return (self._stop_of(reasons.OWNER_GONE, now),)

    def _stop_of(self, reason: str, now: int) -> Publish:
        """Return the message by which the referee stops the games that it plays, so that everybody hears of it."""
        return Publish("control", Control(stamp=now, action="stop", request=self._series.request, reason=reason))

    def held_up(self, lag: int, now: int) -> None:
        """Do not count `lag` ns in which the referee did not run, up to `now`, against those whom it waits for."""
        if self._phase in (Phase.SETUP, Phase.COMMANDS, Phase.POSES):
            self._wake = None if self._wake is None else self._wake + lag
            self._deadline += lag
            self._set_up_at += lag
            self._commanded_at += lag
            self._patience.held_up(lag)

    def _slows_down(self, now: int) -> bool:
        """Wait longer, up to a limit, for those who are late because this machine is too slow. Returns whether it does."""
        if self._phase not in (Phase.SETUP, Phase.COMMANDS, Phase.POSES) or not self._troubles.too_slow():
            return False
        limit, since = self._settings.slow_patience, self._ticked_at
        if self._phase is Phase.SETUP:
            since = self._set_up_at + int(self._settings.setup_patience * SECOND)
        elif self._phase is Phase.COMMANDS:
            since = self._deadline
            if now < since or self._series.players.hider == HUMAN:
                return False
            limit = 3.0 * self._settings.planning_patience if self._step == 0 else 0.25 * limit
        if now - since >= limit * SECOND:
            return False
        self._wake = now + SECOND // 2
        return True

    def _on_time(self, now: int) -> Sequence[Send]:
        if self._phase is Phase.LISTENING and self._listening_since is None:
            self._listening_since = now
            self._wake = now + int(self._settings.settle * SECOND)
            return ()
        if self._wake is None or now < self._wake:
            return ()
        self._wake = None
        if self._phase is Phase.LISTENING:
            return self._finish_listening(now)
        if self._phase in (Phase.PAUSE, Phase.IDLE):
            self._phase = Phase.IDLE
            return self._begin_if_possible(now)
        if self._phase in (Phase.SETUP, Phase.POSES) and (overdue := self._overdue_at(now)) > now:
            self._wake = overdue
            return ()
        if self._slows_down(now):
            return ()
        if self._phase is Phase.SETUP:
            return self._give_up(f"no poses {(now - self._set_up_at) / SECOND:.0f} s after the setup", now)
        if self._phase is Phase.PACING:
            return self._tick(self._step, now)
        if self._phase is Phase.COMMANDS:
            if "hider" not in self._commanded and (
                lacking := self._drivers.lacking(self._series.players.hider, self._alive, now)
            ):
                return self._abort(lacking, now)
            if now < self._deadline:
                self._wake = min(now + SECOND, self._deadline)
                return ()
            late = cast("tuple[Robot, ...]", tuple(robot for robot in ROBOTS if robot not in self._commanded))
            if self._series.rules.step_period == 0.0 or self._step == 0:
                return self._give_up(f"no command from the {' or the '.join(late)} for step {self._step}", now)
            self._wait_for_poses(now)
            return (Publish("tick", Tick(stamp=now, episode=self._number, step=self._step, late=late)),)
        if self._phase is Phase.POSES:
            return self._give_up(f"step {self._step} was not executed within {(now - self._commanded_at) / SECOND:.0f} s", now)
        return ()

    def _overdue_at(self, now: int) -> int:
        """Return when to give up waiting for poses: not while a service that owes them is away, just back, or silent."""
        settings = self._settings
        if self._phase is Phase.SETUP and now >= self._set_up_at + int(settings.setup_limit * SECOND):
            return now
        patience = settings.setup_patience if self._phase is Phase.SETUP else settings.step_patience
        return self._patience.overdue_at(int(patience * SECOND), not self._troubles.missing(self._alive), now)

    def _finish_listening(self, now: int) -> Sequence[Send]:
        self._phase = Phase.IDLE
        self._wake = None
        sends: list[Send] = []
        if self._left_behind > self._number:
            self._number = self._left_behind
            sends.append(self._episode("aborted", now, reason=reasons.RESTARTED))
        sends.extend(self._begin_if_possible(now))
        return sends

    def _on_health(self, health: Health, now: int) -> Sequence[Send]:
        if health.service != "console":
            self._troubles.hear(health)
            self._patience.hear(health.service, now)
            return ()
        self._drivers.hear_console(now)
        return self._begin_if_possible(now) if self._phase is Phase.IDLE else ()

    @property
    def _in_game(self) -> bool:
        return self._phase not in (Phase.LISTENING, Phase.IDLE, Phase.PAUSE)

    def _on_control(self, control: Control, now: int) -> Sequence[Send]:
        if control.action == "pause":
            return self._hold(now)
        if control.action == "resume":
            return self._go_on(now)
        if control.action == "discard":
            return self._discard(control.episode, now)
        if control.action == "seek":
            raise Unexpected("seek is for the replay of a log: games go forward only")
        if control.owner and not (control.request and control.owner in OWNERS):
            raise Unexpected(f"start: games of {control.owner} need a request, and an owner among {OWNERS}")
        if control.action == "start" and control.request in self._known:
            return ()
        if control.request:
            self._known.append(control.request)
        if control.action == "stop" and control.request not in ("", self._series.request):
            return ()
        self._held = False
        self._driver_until = None
        sends: list[Send] = []
        if self._in_game:
            sends.extend(self._abort(reasons.stopped(control.reason) if control.action == "stop" else reasons.REPLACED, now))
        if control.action == "stop":
            self._series.stop()
            self._owner.end()
        else:
            self._series.ask(control)
            self._owner.begin(control.owner, control.owner in self._alive, now)
        if self._phase is not Phase.LISTENING:
            self._phase = Phase.IDLE
            self._wake = None
            sends.extend(self._begin_if_possible(now))
        return sends

    def _hold(self, now: int) -> Sequence[Send]:
        if self._held:
            return ()
        if not self._in_game and self._series.left == 0:
            raise Unexpected("pause: no game is being played, and none is to follow")
        self._held = True
        if self._phase is Phase.PACING:
            self._wake = None
        # In the set-up the world would take a repeated message for another one.
        return (self._episode("running", now),) if self._in_game and self._phase is not Phase.SETUP else ()

    def _go_on(self, now: int) -> Sequence[Send]:
        if not self._held:
            raise Unexpected("resume: nothing is paused")
        self._held = False
        if self._phase is Phase.IDLE:
            return self._begin_if_possible(now)
        if not self._in_game or self._phase is Phase.SETUP:
            return ()
        return [self._episode("running", now), *(self._tick_when_due(now) if self._phase is Phase.PACING else ())]

    def _discard(self, number: int, now: int) -> Sequence[Send]:
        if self._in_game and number == self._number:
            return self._abort(reasons.DISCARDED, now)
        if not 1 <= number <= self._number and self._phase is not Phase.LISTENING:
            raise Unexpected(f"discard: there was no episode {number}")
        return ()

    def _begin_if_possible(self, now: int) -> Sequence[Send]:
        if self._held or self._series.left == 0:
            return ()
        if self._unanswered and now < self._set_up_at + SET_UP_SPACING:
            self._wake = self._set_up_at + SET_UP_SPACING
            return ()
        if self._troubles.missing(self._alive):
            self._driver_until = None
            return ()
        lacking = self._drivers.lacking(self._series.players.hider, self._alive, now)
        if lacking and self._drivers.may_come(self._series.players.hider):
            if self._driver_until is None:
                self._driver_until = now + int(self._settings.driver_patience * SECOND)
            if now < self._driver_until:
                self._wake = self._driver_until
                return ()
        self._driver_until = None
        self._number += 1
        self._series.begin(self._number)
        self._step = 0
        self._poses.clear()
        self._phase = Phase.SETUP
        self._set_up_at = now
        self._unanswered = False
        self._patience.begin(now)
        self._wake = now + int(self._settings.setup_patience * SECOND)
        setup = self._episode("setup", now)
        if lacking:
            sends = [setup, *self._abort(lacking, now)]
            if self._series.left != 0 and self._series.request:  # the next ones would fare no better
                sends.append(self._stop_of(lacking, now))
            self._series.stop()
            self._owner.end()
            return sends
        return (setup,)

    def _on_pose(self, robot: str, pose: Pose, now: int) -> Sequence[Send]:
        expected = {Phase.SETUP: 0, Phase.COMMANDS: self._step + 1, Phase.POSES: self._step + 1}.get(self._phase)
        if pose.episode != self._number or pose.step != expected:
            raise Unexpected(f"{robot}/pose of episode {pose.episode} step {pose.step} while {self._phase.value}")
        self._poses[robot] = pose
        if len(self._poses) < len(ROBOTS):
            return ()
        hider, seeker = self._poses["hider"], self._poses["seeker"]
        self._poses.clear()
        if self._phase is Phase.SETUP:
            self._due = now
            return [self._episode("running", now), *self._tick_when_due(now)]
        reached = self._step + 1
        distance = math.hypot(hider.x - seeker.x, hider.y - seeker.y)
        if self._series.rules.catching and distance <= self._series.rules.catch_distance + CATCH_TOLERANCE:
            return self._end("caught", reached, now)
        if reached >= self._series.rules.maximum_steps:
            return self._end("survived", reached, now)
        self._step = reached
        self._due = self._ticked_at + int(self._series.rules.step_period * SECOND)
        return self._tick_when_due(now)

    def _tick_when_due(self, now: int) -> Sequence[Send]:
        if now >= self._due and not self._held:
            return self._tick(self._step, now)
        self._phase = Phase.PACING
        self._wake = None if self._held else self._due
        return ()

    def _on_command(self, robot: str, command: Command, now: int) -> Sequence[Send]:
        if command.episode == self._number and command.step < self._step:
            return ()  # the poses that followed from it came first: publishers are not ordered among each other
        if self._phase is not Phase.COMMANDS or command.episode != self._number or command.step != self._step:
            raise Unexpected(f"{robot}/command for episode {command.episode} step {command.step} while {self._phase.value}")
        self._commanded.add(robot)
        if len(self._commanded) == len(ROBOTS):
            self._wait_for_poses(now)
        return ()

    def _wait_for_poses(self, now: int) -> None:
        self._phase = Phase.POSES
        self._commanded_at = now
        self._patience.begin(now)
        self._wake = now + int(self._settings.step_patience * SECOND)

    def _tick(self, step: int, now: int) -> Sequence[Send]:
        self._step = step
        self._commanded.clear()
        self._phase = Phase.COMMANDS
        self._ticked_at = now
        plans = step == 0 or self._series.rules.step_period == 0.0
        patience = self._settings.planning_patience if plans else self._settings.command_patience
        self._deadline = now + int(patience * SECOND)
        self._wake = min(self._deadline, now + SECOND) if self._series.players.hider == HUMAN else self._deadline
        return (Publish("tick", Tick(stamp=now, episode=self._number, step=step)),)

    def _end(self, outcome: str, step: int, now: int) -> Sequence[Send]:
        self._step = step
        reason = f"caught at step {step}" if outcome == "caught" else f"not caught in {step} steps"
        episode = self._episode("ended", now, outcome=outcome, caught_step=step if outcome == "caught" else None, reason=reason)
        self._rest(now)
        return (episode,)

    def _abort(self, reason: str, now: int) -> Sequence[Send]:
        episode = self._episode("aborted", now, reason=reason)
        self._unanswered = self._phase is Phase.SETUP
        self._rest(now)
        return (episode,)

    def _give_up(self, reason: str, now: int) -> Sequence[Send]:
        return self._abort(self._troubles.blame(reason, self._alive), now)

    def _rest(self, now: int) -> None:
        self._held = self._held and self._series.left != 0
        if self._series.left == 0:
            self._owner.end()
        self._phase = Phase.PAUSE
        self._wake = now + (int(self._settings.pause * SECOND) if self._series.rules.step_period > 0 else 0)

    def _episode(self, phase: GamePhase, now: int, **how: Any) -> Publish:
        paused = self._held and (phase == "running" or self._series.left != 0)
        return Publish("episode", self._series.episode(self._number, phase, stamp=now, step=self._step, paused=paused, **how))
