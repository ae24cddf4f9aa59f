"""Brings the robots to the starts of a game: draws them, drives there, tries again, and gives up with a reason."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from schemas import ROBOTS, Episode, Layout
from services.robot.driven_robot import DrivenRobot
from services.robot.motion_control import Ended
from services.robot.placing import Arena, Placing
from services.robot.pose_estimate import Place
from vantage.service import SECOND, Send
from vantage.world.layout import ImpossibleLayout, boxes_of
from vantage.world.start import Placed, draw_start

SIGHT = SECOND // 2
"""ns: an older track does not tell where a robot is."""
AGAIN = SECOND // 4
"""ns between two attempts to find a way, or to see the robots."""
PATIENCE = 9 * SECOND
"""ns without progress after which the game is given up."""
LIMIT = 60 * SECOND
"""ns after which it is given up whatever progress there is: a robot may drive and be stuck again and again."""
ASKING = SECOND
"""ns that the wish for a game, which a person said, may be heard later than the game that it led to."""


@dataclass(slots=True)
class Starting:
    """See module.

    Attributes:
        robots: those driven from here.
        episode: whose starts are drawn, exactly as the simulator does.
        where: where a robot was seen, and when by the own clock; None when it never was.
        speed: m/s of a wheel at most.
        since: when it began, ns.
        trouble: why it does not go on, for people.
        given_up: nothing more will be tried.
        wake: when to try again, ns; None: nothing to wait for.
    """

    robots: Mapping[str, DrivenRobot]
    episode: Episode
    where: Callable[[str], tuple[Place, int] | None]
    speed: float
    since: int
    trouble: str = ""
    given_up: bool = False
    wake: int | None = None
    _placing: Placing | None = None
    _starts: dict[str, Placed] | None = None
    _progress: int = 0
    _begun: int = 0
    _failure: str = ""

    @property
    def starts(self) -> dict[str, Placed] | None:
        """Where the robots stand, once they do."""
        return self._starts if self._placing is not None and self._placing.done else None

    def held_up(self, lag: int) -> None:
        """Do not count `lag` ns in which the driver did not run."""
        self._progress += lag
        self._begun += lag
        self.since += lag

    def go_on(self, layout: Layout | None, now: int) -> list[Send]:
        """Begin the next drive, if none is under way and everything for it is known."""
        if self._placing is None and layout is not None and layout.episode == self.episode.episode:
            self._draw(layout, now)
        if self._placing is None or self.given_up:
            return []
        if self._placing.done:
            return []
        if now - self._begun >= LIMIT:
            return self._give_up(now)
        self.wake = self._begun + LIMIT
        if self._placing.moving is not None:
            return []
        held = [robot for robot in self.robots.values() if robot.link.held]
        if held:
            return self._clear(held, now)
        places = self._places(now)
        missing = [robot for robot in ROBOTS if robot not in places]
        self.trouble = f"the overhead camera does not see {' and '.join(missing)}" if missing else self._placing.plan(places)
        if self.trouble:
            self._try_later(now)
            return []
        return self._drive(now)

    def ended(self, ended: Ended, now: int) -> list[Send]:
        """Take note of how a drive ended, and go on."""
        if self._placing is None or self._placing.moving is None:
            return []
        if ended.result == "completed":
            self._progress = now
            self._placing.arrived()
            return self._drive(now) if self._placing.moving is not None else self.go_on(None, now)
        self.trouble = self._failure = f"{self._where_it_is(self._placing.moving)}: {ended.result}, {ended.reason}"
        self._placing.interrupted()
        self._try_later(now)
        return []

    def _draw(self, layout: Layout, now: int) -> None:
        rules, boxes = self.episode.rules, boxes_of(layout)
        distances = rules.start_distance_minimum, rules.start_distance_maximum
        try:
            drawn = draw_start(boxes, layout.width, layout.depth, self.episode.seed, *distances)
        except ImpossibleLayout as error:
            self.trouble, self.given_up = str(error), True
            return
        starts = dict(zip(ROBOTS, drawn, strict=True))
        self._starts = {robot: starts[robot] for robot in ROBOTS if robot in self.robots}
        self._placing = Placing(Arena(boxes, layout.width, layout.depth), self._starts)
        self._progress = self._begun = now

    def _drive(self, now: int) -> list[Send]:
        assert self._placing is not None and self._placing.moving is not None
        line = self._placing.next_line()
        assert line is not None
        robot = self.robots[self._placing.moving]
        robot.begin(line, now, self.speed)
        sends, ended = robot.advance(now)
        return sends if ended is None else [*sends, *self.ended(ended, now)]

    def _try_later(self, now: int) -> None:
        if now - self._progress > PATIENCE:
            self.given_up = True
        else:
            self.wake = now + AGAIN

    def _clear(self, held: list[DrivenRobot], now: int) -> list[Send]:
        """Clear emergency stops if a person has asked for a game since; the next of ten games asked for before does not."""
        kept = [robot.link.trouble(now) for robot in held if not robot.link.may_clear]
        self.trouble = "; ".join(kept)
        if kept and now - self.since > ASKING:
            self.given_up = True
            return []
        self._try_later(now)
        return [] if kept else [send for robot in held for send in robot.clear(now)]

    def _give_up(self, now: int) -> list[Send]:
        """Stop trying, and say who stands where."""
        assert self._placing is not None
        moving, self.given_up, self.wake = self._placing.moving, True, None
        if not self.trouble:
            slow = "" if moving is None else f"{self._where_it_is(moving)}: not there within {LIMIT // SECOND} s"
            self.trouble = self._failure or slow
        self._placing.interrupted()
        return [] if moving is None else self.robots[moving].halt(now)

    def _where_it_is(self, robot: str) -> str:
        found = self.where(robot)
        place = "" if found is None else f" and stands at ({found[0].x:.2f}, {found[0].y:.2f}) m"
        return f"robot {robot} did not get to its start{place}"

    def _places(self, now: int) -> dict[str, Place]:
        """Return where the robots are that were seen lately."""
        seen = {robot: self.where(robot) for robot in ROBOTS}
        return {robot: found[0] for robot, found in seen.items() if found is not None and now - found[1] <= SIGHT}
