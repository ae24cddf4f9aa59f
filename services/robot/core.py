"""The driver as a pure core: brings the robots to the start of a game, then carries out both commands of every step."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

import msgspec

from schemas import PRIMITIVES, ROBOTS, Command, Control, Episode, Layout, Tick, Track
from services.robot.declaration import DECLARATION
from services.robot.driven_robot import DrivenRobot
from services.robot.motion_control import Ended
from services.robot.pose_estimate import Place
from services.robot.settings import NO_PORT, RobotSettings
from services.robot.starting import Starting
from services.robot.stepping import Stepping
from vantage.service import SECOND, Arrived, Captured, Received, Send, SenderClock, Unexpected, Woken
from vantage.world.arena import STAY

_NUMBER_OF_PRIMITIVE = {name: number for number, name in enumerate(PRIMITIVES)}


class _Phase(Enum):
    IDLE = "outside a game"
    LISTENING = "joining a game under way"
    STARTING = "driving to the starts"
    PLAYING = "carrying out commands"


class RobotCore:
    """See module. A robot without a port is somebody else's: it is driven around, and never spoken for."""

    declaration = DECLARATION

    def __init__(self, settings: RobotSettings | None = None) -> None:
        self._settings = settings or RobotSettings()
        self._robots: dict[str, DrivenRobot] = {}
        for robot in ROBOTS:
            if self._settings.port_of(robot) != NO_PORT:
                self._robots[robot] = DrivenRobot(robot, self._settings)
        self._tracks: dict[str, Track] = {}  # the last that showed each robot, its stamp of the own clock
        self._clocks: dict[str, SenderClock] = {robot: SenderClock() for robot in ROBOTS}  # the tracker's, or the camera's
        self._layout: Layout | None = None
        self._episode = 0
        self._phase = _Phase.IDLE
        self._wake: int | None = None
        self._starting: Starting | None = None
        self._stepping = Stepping(self._robots, self._settings.control, self.place_of)
        self._early: dict[str, Command | Tick] = {}  # outside a game: what may belong to one that we hear of later
        self._request = ""
        self._trouble = ""
        self._now = 0

    @property
    def trouble(self) -> str:
        """What is wrong now, for people."""
        here = self._starting.trouble if self._starting is not None else self._trouble
        of_robots = [robot.trouble(self._now) for robot in self._robots.values()]
        return "; ".join(dict.fromkeys(text for text in (*of_robots, here) if text))

    def wake_at(self) -> int | None:
        wakes: list[int | None] = [self._wake, self._starting.wake if self._starting is not None else None]
        return min((wake for wake in (*wakes, *(r.wake_at() for r in self._robots.values())) if wake is not None), default=None)

    def held_up(self, lag: int, now: int) -> None:
        """Do not count `lag` ns in which the driver did not run, up to `now`, against robots and cameras."""
        for robot in self._robots.values():
            robot.held_up(lag, now)
        if self._starting is not None:
            self._starting.held_up(lag)

    def step(self, received: Received, now: int) -> Sequence[Send]:
        self._now = now
        if isinstance(received, Captured):
            return self._with_end(received.device, *self._robots[received.device].hear(received, now), now)
        if isinstance(received, Woken):
            return self._on_time(now)
        if not isinstance(received, Arrived):
            return ()
        message, name = received.message, received.key.partition("/")[0]
        if self._phase is _Phase.IDLE and isinstance(message, Command | Tick):
            self._early[received.key] = message
            return ()
        if isinstance(message, Track):
            return self._on_track(name, message, received.published, now)
        if isinstance(message, Command):
            return self._on_command(name, message, now)
        if isinstance(message, Tick):
            return self._on_tick(message, now)
        if isinstance(message, Layout):
            self._layout = message
            return self._go_on(now)
        if isinstance(message, Episode):
            return self._on_episode(message, now)
        if (
            isinstance(message, Control)
            and message.action == "start"
            and not (message.request and message.request == self._request)
        ):
            self._request = message.request  # repeated, it is not a person who asks anew after an emergency stop
            for robot in self._robots.values():
                robot.link.asked()
            return self._go_on(now)
        return ()

    def _on_time(self, now: int) -> Sequence[Send]:
        sends: list[Send] = []
        for name, robot in self._robots.items():
            if robot.wake_at() <= now:
                sends.extend(self._with_end(name, *robot.advance(now), now))
        if self._starting is not None and self._starting.wake is not None and self._starting.wake <= now:
            sends.extend(self._go_on(now))
        if self._wake is not None and self._wake <= now:
            self._wake = None
            if self._phase is _Phase.LISTENING:
                self._phase = _Phase.PLAYING
                sends.extend(self._stepping.interrupted(now))
                sends.extend(self._go_on(now))
        return sends

    def _on_track(self, name: str, track: Track, published: int, now: int) -> Sequence[Send]:
        taken = self._clocks[name].take(track.stamp, published, now)
        if taken is None:
            return ()
        track = msgspec.structs.replace(track, stamp=taken)
        if track.seen:
            self._tracks[name] = track
        if name in self._robots:
            self._robots[name].see(track, now)
        return ()

    def _on_episode(self, episode: Episode, now: int) -> Sequence[Send]:
        known = self._episode == episode.episode
        if episode.phase == "setup":
            return self._set_up(episode, now)
        if episode.phase == "running":
            if not known:
                # We were restarted. What comes within a moment may have been said before that.
                self._episode, self._phase, self._starting = episode.episode, _Phase.LISTENING, None
                self._stepping.begin(episode.episode, None)
                self._wake = now + int(self._settings.settle * SECOND)
                early, self._early = self._early, {}
                for key, message in early.items():
                    if message.episode == episode.episode:
                        self.step(Arrived(key, message), now)
            return ()
        if not known:
            return ()
        self._episode, self._phase, self._starting, self._wake = 0, _Phase.IDLE, None, None
        self._stepping.begin(0, 0)
        return [send for robot in self._robots.values() for send in robot.halt(now)]

    def _set_up(self, episode: Episode, now: int) -> Sequence[Send]:
        self._episode, self._phase, self._wake, self._trouble = episode.episode, _Phase.STARTING, None, ""
        self._stepping.begin(episode.episode, 0)
        sends = [send for robot in self._robots.values() for send in robot.halt(now)]
        if not self._robots:
            self._phase, self._starting = _Phase.PLAYING, None
            return sends
        speed = self._settings.control.placing_speed
        self._starting = Starting(self._robots, episode, self._sighting_of, speed, now)
        return [*sends, *self._go_on(now)]

    def _go_on(self, now: int) -> Sequence[Send]:
        """Do what waited for a layout, a track, or time."""
        if self._starting is not None:
            return [*self._starting.go_on(self._layout, now), *self._report_starts(now)]
        if self._phase is _Phase.PLAYING and self._layout is not None:
            return self._stepping.carry_out(self._layout, now)
        return ()

    def _report_starts(self, now: int) -> Sequence[Send]:
        """Say so when the robots are at their starts, or will not get there."""
        starting = self._starting
        if starting is None or (starting.starts is None and not starting.given_up):
            return ()
        self._phase, self._starting, self._trouble = _Phase.PLAYING, None, starting.trouble
        if starting.starts is not None:
            self._trouble = ""
            return self._stepping.started(starting.starts, starting.since, now)
        return self._stepping.not_started(starting.trouble, starting.since, now)

    def _with_end(self, robot: str, sends: list[Send], ended: Ended | None, now: int) -> Sequence[Send]:
        if ended is None:
            return sends
        if self._starting is not None:
            return [*sends, *self._starting.ended(ended, now), *self._report_starts(now)]
        return [*sends, *self._stepping.ended(robot, ended, now)]

    def _on_command(self, name: str, command: Command, now: int) -> Sequence[Send]:
        self._check(f"{name}/command", command.episode, command.step)
        if name in self._stepping.commands:
            raise Unexpected(f"a second {name}/command for step {command.step}")
        self._stepping.commands[name] = _NUMBER_OF_PRIMITIVE[command.primitive]
        return self._go_on(now)

    def _on_tick(self, tick: Tick, now: int) -> Sequence[Send]:
        if not tick.late and tick.episode == self._episode and self._phase is not _Phase.LISTENING:
            return ()  # a tick that opens a step may come after the commands it led to
        self._check("tick", tick.episode, tick.step)
        for robot in tick.late:
            self._stepping.commands.setdefault(robot, STAY)
        return self._go_on(now)

    def _check(self, what: str, episode: int, step: int) -> None:
        """Refuse what does not belong to the step at which the robots stand; who joins a game learns the step from it."""
        stepping = self._stepping
        playing = self._episode == episode and self._phase in (_Phase.LISTENING, _Phase.PLAYING)
        if playing and (stepping.step is None or (self._phase is _Phase.LISTENING and step > stepping.step)):
            stepping.step = step
            stepping.commands.clear()
        if not playing or stepping.step != step:
            raise Unexpected(f"{what} of episode {episode} step {step} while {self._phase.value}, step {stepping.step}")

    def _sighting_of(self, robot: str) -> tuple[Place, int] | None:
        """Return where a robot is, as its tracks and its wheels tell, and when (own clock) it was seen last; None: never."""
        track = self._tracks.get(robot)
        if track is None:
            return None
        known = self._robots[robot].control.estimate.place if robot in self._robots else None
        return known or Place(track.x, track.y, track.heading), track.stamp

    def place_of(self, robot: str) -> Place | None:
        """Return where a robot is, as its tracks and its wheels tell; None when it was never seen."""
        sighting = self._sighting_of(robot)
        return None if sighting is None else sighting[0]
