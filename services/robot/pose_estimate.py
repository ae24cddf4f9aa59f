"""Where a robot is now: its encoders between pictures, its tracked pose whenever a picture of it comes, late as it is.

A Kalman filter with delayed measurements: a tracked pose corrects the estimate at the time of its capture, and with it
everything dead reckoned since.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from schemas import Track
from services.robot.settings import Control, Wheels
from vantage.service import SECOND

KEPT = 128
"""Dead reckoned poses kept: 2.5 s of telemetry, longer than any picture is late."""

DRIFT = 0.05
"""Standard deviation of dead reckoning, relative to the way of the wheels."""
BLUR = 0.008
"""s by which the stamp of a picture of a moving robot may be off."""
SURPRISE = 4.0
"""Standard deviations beyond which a tracked pose contradicts the estimate; the second in a row is believed."""
LONGEST_GAP = SECOND // 5
"""ns between two telemetry lines beyond which nobody knows when the wheels turned in between."""
REST_TICKS = 1
"""Ticks between two telemetry lines, up to which a wheel rests."""


class Place(NamedTuple):
    """x, y in m, arena frame; heading in rad, not wrapped."""

    x: float
    y: float
    heading: float


@dataclass(slots=True)
class _Reckoned:
    """One entry of the past: the pose at a time, and how far each wheel had turned by then, m."""

    stamp: int
    x: float
    y: float
    heading: float
    left: float
    right: float


def moved(place: Place, ahead: float, turn: float) -> Place:
    """Return a place after an arc of `ahead` m and `turn` rad."""
    middle = place.heading + 0.5 * turn
    return Place(place.x + ahead * math.cos(middle), place.y + ahead * math.sin(middle), place.heading + turn)


class PoseEstimate:
    """See module.

    Attributes:
        seen: when the last picture that showed the robot was taken, own clock, ns; None before the first.
        rest: time since which the wheels have not turned; None while they do.
        frames_at_rest: pictures of the robot since then.
    """

    def __init__(self, wheels: Wheels, control: Control) -> None:
        self._wheels = wheels
        self._control = control
        self._past: deque[_Reckoned] = deque(maxlen=KEPT)
        self._distance_variance = self._heading_variance = math.inf
        self._surprised = False
        self._quiet_since: int | None = None
        self.seen: int | None = None
        self.rest: int | None = None
        self.frames_at_rest = 0

    @property
    def place(self) -> Place | None:
        """Where the robot was at its last telemetry; None before it was seen."""
        if not self._past or self.seen is None:
            return None
        newest = self._past[-1]
        return Place(newest.x, newest.y, newest.heading)

    def measure(self, stamp: int, left_ticks: int, right_ticks: int) -> None:
        """Take the ticks that the wheels have turned since the last measurement, at a time (ns)."""
        newest = self._past[-1] if self._past else _Reckoned(stamp, 0.0, 0.0, 0.0, 0.0, 0.0)
        left, right = left_ticks * self._wheels.metres_per_tick, right_ticks * self._wheels.metres_per_tick
        turn = (right - left) / self._wheels.axle_track
        place = moved(Place(newest.x, newest.y, newest.heading), 0.5 * (left + right), turn)
        way = 0.5 * (abs(left) + abs(right))
        # Slip is a random walk (variance grows with the way); over a step of the game, about DRIFT of it.
        self._distance_variance += DRIFT**2 * 0.010 * way
        self._heading_variance += DRIFT**2 * 0.010 * way * 2.0 / self._wheels.axle_track**2
        quiet = max(abs(left_ticks), abs(right_ticks)) <= REST_TICKS
        if not quiet:
            self._quiet_since = self.rest = None
            self.frames_at_rest = 0
        elif self._quiet_since is None:
            self._quiet_since = newest.stamp
        elif self.rest is None:
            self.rest = self._quiet_since
            self.frames_at_rest = 0
        self._past.append(_Reckoned(max(stamp, newest.stamp), *place, newest.left + left, newest.right + right))

    def see(self, track: Track) -> None:
        """Take a tracked pose, its stamp of the own clock; one that the camera did not see changes nothing."""
        if not track.seen or (self.seen is not None and track.stamp <= self.seen):
            return
        if not self._past:
            self._past.append(_Reckoned(track.stamp, track.x, track.y, track.heading, 0.0, 0.0))
        first = self.seen is None
        self.seen = track.stamp
        if self.rest is not None and track.stamp >= self.rest:
            self.frames_at_rest += 1
        then, speed, rate = self._at(track.stamp)
        xx, _, _, yy, _, hh = track.covariance
        distance_noise = max(0.5 * (xx + yy), self._control.track_distance**2) + (BLUR * speed) ** 2
        heading_noise = max(hh, self._control.track_heading**2) + (BLUR * rate) ** 2
        away_x, away_y = track.x - then.x, track.y - then.y
        turned = math.remainder(track.heading - then.heading, math.tau)
        surprising = away_x * away_x + away_y * away_y > SURPRISE**2 * (
            self._distance_variance + distance_noise
        ) or turned * turned > SURPRISE**2 * (self._heading_variance + heading_noise)
        if first or (surprising and self._surprised):
            self._distance_variance = self._heading_variance = math.inf
        elif surprising:
            self._surprised = True
            return
        self._surprised = False
        near = _gain(self._distance_variance, distance_noise)
        straight = _gain(self._heading_variance, heading_noise)
        self._distance_variance = near * distance_noise
        self._heading_variance = straight * heading_noise
        self._correct(then, near * away_x, near * away_y, straight * turned)

    def wheels_at(self, stamp: int) -> tuple[float, float] | None:
        """Return how far (m) the left and right wheel had turned at a time; None when that is not known."""
        if len(self._past) < 2 or stamp < self._past[0].stamp:
            return None
        before, after, share = self._around(stamp)
        if max(after.stamp, stamp) - before.stamp > LONGEST_GAP:
            return None
        return before.left + share * (after.left - before.left), before.right + share * (after.right - before.right)

    def _around(self, stamp: int) -> tuple[_Reckoned, _Reckoned, float]:
        """Return the entries before and after a time, and where between them it lies, 0 to 1."""
        after = self._past[-1]
        for entry in reversed(self._past):
            if entry.stamp <= stamp:
                span = after.stamp - entry.stamp
                return entry, after, min((stamp - entry.stamp) / span, 1.0) if span > 0 else 0.0
            after = entry
        return after, after, 0.0

    def _at(self, stamp: int) -> tuple[Place, float, float]:
        """Return the estimated place at a time, the speed (m/s) and the turn rate (rad/s) then."""
        before, after, share = self._around(stamp)
        x, y = before.x + share * (after.x - before.x), before.y + share * (after.y - before.y)
        heading = before.heading + share * (after.heading - before.heading)
        span = (after.stamp - before.stamp) / SECOND
        if span <= 0.0:
            return Place(x, y, heading), 0.0, 0.0
        speed = math.hypot(after.x - before.x, after.y - before.y) / span
        return Place(x, y, heading), speed, abs(after.heading - before.heading) / span

    def _correct(self, then: Place, shift_x: float, shift_y: float, turn: float) -> None:
        """Move the whole past so that `then` is shifted and turned: what was reckoned since turns about it."""
        cosine, sine = math.cos(turn), math.sin(turn)
        for entry in self._past:
            x, y = entry.x - then.x, entry.y - then.y
            entry.x = then.x + shift_x + cosine * x - sine * y
            entry.y = then.y + shift_y + sine * x + cosine * y
            entry.heading += turn


def _gain(variance: float, noise: float) -> float:
    return 1.0 if math.isinf(variance) else variance / (variance + noise)
