"""An emulated robot body: two driven wheels that lag and slip, in an arena it collides with. Continuous, stepped in time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vantage.compiled import kernel
from vantage.world.arena import ARENA_SIZE
from vantage.world.motion import box_distance

LONGEST_STEP = 0.004
"""s; longer steps are cut."""


@dataclass(frozen=True)
class BodySettings:
    """The true body of an emulated robot. What the driver believes of it differs by a per cent or two."""

    radius: float = 0.063
    """m, of the disc that collides; the game's disc of 65 mm is drawn around the body with 2 mm to spare"""
    axle_track: float = 0.0912
    """m between the wheels' contact points"""
    wheel_radius: float = 0.016
    """m, as the encoders count it"""
    left_scale: float = 1.012
    """true over nominal radius of the left wheel"""
    right_scale: float = 0.994
    """true over nominal radius of the right wheel"""
    lag: float = 0.035
    """s, time constant with which a wheel's speed follows"""
    slip: float = 0.03
    """standard deviation of a wheel's travel over ground after 10 mm, relative; grows with the root of the travel"""
    fastest: float = 0.40
    """m/s of a wheel at most"""
    width: float = ARENA_SIZE
    """m, arena along x"""
    depth: float = ARENA_SIZE
    """m, arena along y"""


@kernel
def clearance(
    boxes: npt.NDArray[np.float64], width: float, depth: float, x: float, y: float, radius: float, other_x: float, other_y: float
) -> float:
    """Return the free space around a disc, m, negative where it overlaps a wall, a box or the other robot's disc (NaN: none)."""
    free = min(x, y, width - x, depth - y) - radius
    for index in range(boxes.shape[0]):
        free = min(free, box_distance(boxes, index, x, y) - radius)
    apart = math.hypot(x - other_x, y - other_y) - 2.0 * radius
    return min(free, apart) if apart == apart else free


class Body:
    """See module.

    Attributes:
        x, y, heading: where it truly is: m, m, rad (ccw from +x, not wrapped).
        left, right: m that the wheels have turned, at their nominal radius: what encoders count.
        left_speed, right_speed: m/s of the wheels now.
        touching: whether something held it in the last step.
    """

    def __init__(self, settings: BodySettings, x: float, y: float, heading: float) -> None:
        self.settings = settings
        self.x, self.y, self.heading = x, y, heading
        self.left = self.right = 0.0
        self.left_speed = self.right_speed = 0.0
        self.touching = False

    def step(
        self,
        dt: float,
        left: float,
        right: float,
        boxes: npt.NDArray[np.float64],
        other: tuple[float, float] | None,
        generator: np.random.Generator,
    ) -> None:
        """Let `dt` s pass with the wheels told to turn at `left` and `right` m/s.

        boxes float64 [n, 7] (see `vantage.world.layout.boxes_of`); `other`: the other robot's centre, m. The same settings,
        generator and sequence of arguments give the same motion.
        """
        pieces = max(1, math.ceil(dt / LONGEST_STEP - 1e-9))
        for _ in range(pieces):
            self._step(dt / pieces, left, right, boxes, other, generator)

    def _step(
        self,
        dt: float,
        left: float,
        right: float,
        boxes: npt.NDArray[np.float64],
        other: tuple[float, float] | None,
        generator: np.random.Generator,
    ) -> None:
        settings = self.settings
        follow = -math.expm1(-dt / settings.lag) if settings.lag > 0.0 else 1.0
        self.left_speed += follow * (min(max(left, -settings.fastest), settings.fastest) - self.left_speed)
        self.right_speed += follow * (min(max(right, -settings.fastest), settings.fastest) - self.right_speed)
        turned_left, turned_right = self.left_speed * dt, self.right_speed * dt
        self.left += turned_left
        self.right += turned_right
        noise_left, noise_right = generator.standard_normal(2)
        over_left = settings.left_scale * turned_left + settings.slip * math.sqrt(0.010 * abs(turned_left)) * noise_left
        over_right = settings.right_scale * turned_right + settings.slip * math.sqrt(0.010 * abs(turned_right)) * noise_right
        ahead = 0.5 * (over_left + over_right)
        turn = (over_right - over_left) / settings.axle_track
        middle = self.heading + 0.5 * turn
        x, y = self.x + ahead * math.cos(middle), self.y + ahead * math.sin(middle)
        self.heading += turn  # a disc turns on the spot whatever it touches
        other_x, other_y = other if other is not None else (math.nan, math.nan)
        arena = (boxes, settings.width, settings.depth)
        free = clearance(*arena, x, y, settings.radius, other_x, other_y)
        self.touching = free < 0.0 and free < clearance(*arena, self.x, self.y, settings.radius, other_x, other_y)
        if not self.touching:
            self.x, self.y = x, y
