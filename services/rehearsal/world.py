"""The rehearsed table: two robots with their firmware among boxes, moved by the clock."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from schemas import ROBOTS, Box
from vantage.rehearsal.body import Body, BodySettings
from vantage.rehearsal.firmware import TICK, Firmware, FirmwareSettings
from vantage.world.layout import boxes_array

LONGEST_LEAP = 1_000_000_000
"""ns that a world which was held up catches up with; after longer (a suspended machine) it goes on from now, as if asleep."""


@dataclass(frozen=True)
class WorldSettings:
    """Bodies and electronics of both robots."""

    body: BodySettings = field(default_factory=BodySettings)
    firmware: FirmwareSettings = field(default_factory=FirmwareSettings)


class World:
    """See module.

    Args:
        starts: of hider and seeker: x, y in m and heading in rad.
        seed: of slip and of the cables.

    Attributes:
        boxes: float64 [n, 7] (`vantage.world.layout.boxes_of`).
    """

    def __init__(
        self,
        obstacles: Sequence[Box],
        starts: Sequence[tuple[float, float, float]],
        seed: int,
        settings: WorldSettings | None = None,
    ) -> None:
        settings = settings or WorldSettings()
        self.boxes = boxes_array(tuple(obstacles))
        # No two robots are built alike: the seeker's wheels err the other way.
        body = settings.body
        bodies = (body, replace(body, left_scale=body.right_scale, right_scale=body.left_scale))
        self.firmware: dict[str, Firmware] = {
            robot: Firmware(Body(bodies[index], *starts[index]), settings.firmware, seed=2 * seed + index)
            for index, robot in enumerate(ROBOTS)
        }
        self._now: int | None = None
        self._slept = 0  # ns, which the robots' clocks do not show

    def feed(self, robot: str, data: bytes, now: int) -> None:
        """Hand a robot what came over its line at `now` (ns)."""
        self.firmware[robot].feed(data, now - self._slept)

    def advance(self, now: int) -> dict[str, bytes]:
        """Let time pass up to `now` (ns); return what each robot has sent over its line meanwhile."""
        if self._now is None:
            self._now = now - TICK
        now -= self._slept
        if now - self._now > LONGEST_LEAP:
            self._slept += now - self._now
            now = self._now
        said = dict.fromkeys(ROBOTS, b"")
        while self._now < now:
            until = min(self._now + TICK, now)
            for index, robot in enumerate(ROBOTS):
                other = self.firmware[ROBOTS[1 - index]].body
                said[robot] += self.firmware[robot].advance(until, self.boxes, (other.x, other.y))
            self._now = until
        return {robot: data for robot, data in said.items() if data}

    def poses(self) -> npt.NDArray[np.float64]:
        """Where the robots are: float64 [2, 3], x, y in m and heading in rad."""
        bodies = (self.firmware[robot].body for robot in ROBOTS)
        return np.array([(body.x, body.y, body.heading) for body in bodies])

    def speeds(self) -> npt.NDArray[np.float64]:
        """How they move: float64 [2, 3], m/s along x and y and rad/s (without what slips)."""
        rows = []
        for robot in ROBOTS:
            body = self.firmware[robot].body
            ahead = 0.0 if body.touching else 0.5 * (body.left_speed + body.right_speed)
            turn = (body.right_speed - body.left_speed) / body.settings.axle_track
            rows.append((ahead * math.cos(body.heading), ahead * math.sin(body.heading), turn))
        return np.array(rows)
