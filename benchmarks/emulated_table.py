"""A table in virtual time: the driver's real core, real protocol lines, emulated robots, and a tracker that is late and noisy."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from schemas import ROBOTS, Box, Episode, Layout, Message, Motion, Rules, Track
from services.robot.core import RobotCore
from services.robot.settings import NO_PORT, RobotSettings
from vantage.rehearsal.body import Body, BodySettings
from vantage.rehearsal.firmware import Firmware, FirmwareSettings
from vantage.service import SECOND, Arrived, Captured, Publish, Received, Unexpected, Woken, Write
from vantage.world.layout import boxes_array

TICK = SECOND // 250
"""ns by which virtual time goes on."""


@dataclass(frozen=True)
class TrackerSettings:
    """How the overhead camera sees the robots."""

    rate: float = 30.0
    """frames a second"""
    latency: float = 0.040
    """s from capture to the track's arrival"""
    distance_noise: float = 0.0005
    """m, standard deviation of a tracked place along x and y"""
    heading_noise: float = math.radians(0.2)
    """rad, standard deviation of a tracked heading"""
    missed: float = 0.01
    """share of the frames in which a robot is not seen"""
    clock: float = 0.0
    """s by which the camera's clock is ahead of the driver's"""
    transport: float = 0.002
    """s of the latency that pass after the track was published"""


class EmulatedTable:
    """See module.

    Attributes:
        now: virtual time, ns.
        bodies, firmwares: of hider and seeker, by name.
        motions: what the driver has reported, in order.
        silent: robots that the camera does not see now.
        clock: ns by which the camera's clock is ahead of the driver's; may be changed, as by somebody who sets it.
        unexpected: messages that the driver set aside.
    """

    def __init__(
        self,
        places: Sequence[tuple[float, float, float]] = ((0.3, 0.3, 0.0), (0.9, 0.9, math.pi)),
        obstacles: tuple[Box, ...] = (),
        settings: RobotSettings | None = None,
        body: BodySettings | None = None,
        firmware: FirmwareSettings | None = None,
        tracker: TrackerSettings | None = None,
        seed: int = 1,
    ) -> None:
        self.now = 1_000 * SECOND
        self.settings = settings or RobotSettings(hider_port="pty-hider", seeker_port="pty-seeker")
        self.obstacles = obstacles
        self.boxes = boxes_array(obstacles)
        self.tracker = tracker or TrackerSettings()
        body = body or BodySettings()
        self.bodies = {robot: Body(body, *place) for robot, place in zip(ROBOTS, places, strict=True)}
        self.firmwares = {
            robot: Firmware(self.bodies[robot], firmware or FirmwareSettings(), seed=2 * seed + index)
            for index, robot in enumerate(ROBOTS)
        }
        self.core = RobotCore(self.settings)
        self.motions: list[tuple[str, Motion]] = []
        self.silent: set[str] = set()
        self.clock = int(self.tracker.clock * SECOND)
        self.unexpected = 0
        self._generator = np.random.default_rng((seed, 7))
        self._frame = 0
        self._coming: deque[tuple[int, str, Track]] = deque()

    def place_of(self, robot: str) -> tuple[float, float, float]:
        """Return where a robot truly is: x, y in m, heading in rad."""
        body = self.bodies[robot]
        return body.x, body.y, body.heading

    def say(self, key: str, message: Message) -> None:
        """Let the driver hear a message."""
        self.give(Arrived(key, message))

    def set_up(self, number: int = 1, seed: int = 5, **rules: object) -> None:
        """Set up an episode and tell the layout."""
        episode = Episode(stamp=self.now, episode=number, seed=seed, phase="setup", rules=Rules(**rules))  # type: ignore[arg-type]
        self.say("episode", episode)
        self.say("layout", Layout(stamp=self.now, episode=number, obstacles=self.obstacles))

    def give(self, received: Received) -> None:
        """Let the driver react to an event, and take what it sends."""
        try:
            sends = self.core.step(received, self.now)
        except Unexpected:
            self.unexpected += 1
            return
        for send in sends:
            if isinstance(send, Write):
                self.firmwares[send.device].feed(send.data, self.now)
            elif isinstance(send, Publish) and isinstance(send.message, Motion):
                self.motions.append((send.key.partition("/")[0], send.message))

    def run(self, until: Callable[[], bool], limit: float) -> bool:
        """Let time pass until `until()`, `limit` s at most. Returns whether it came true."""
        end = self.now + int(limit * SECOND)
        while self.now < end:
            if until():
                return True
            self.tick()
        return until()

    def tick(self) -> None:
        """Let `TICK` pass."""
        self.now += TICK
        for robot, other in zip(ROBOTS, reversed(ROBOTS), strict=True):
            data = self.firmwares[robot].advance(self.now, self.boxes, self.place_of(other)[:2])
            if data and self.settings.port_of(robot) != NO_PORT:
                self.give(Captured(robot, data, self.now))
        self._look()
        while self._coming and self._coming[0][0] <= self.now:
            _, robot, track = self._coming.popleft()
            published = track.stamp + int((self.tracker.latency - self.tracker.transport) * SECOND)
            self.give(Arrived(f"{robot}/track", track, published))
        wake = self.core.wake_at()
        if wake is not None and wake <= self.now:
            self.give(Woken())

    def _look(self) -> None:
        """Take a picture when it is time."""
        frame = int(self.now * self.tracker.rate / SECOND)
        if frame == self._frame:
            return
        self._frame = frame
        for robot in ROBOTS:
            x, y, heading = self.place_of(robot)
            noise: npt.NDArray[np.float64] = self._generator.standard_normal(3)
            missed = self._generator.random() < self.tracker.missed
            if missed or robot in self.silent:
                continue
            track = Track(
                stamp=self.now + self.clock,
                x=float(x + self.tracker.distance_noise * noise[0]),
                y=float(y + self.tracker.distance_noise * noise[1]),
                heading=math.remainder(heading + self.tracker.heading_noise * noise[2], math.tau),
            )
            self._coming.append((self.now + int(self.tracker.latency * SECOND), robot, track))
