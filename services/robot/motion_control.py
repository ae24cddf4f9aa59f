"""Drives one robot to a target: wheel speeds closed on its estimated pose, until its tracked pose at rest says it is there.

The robot faces the target if it must, drives at it, aligns itself, settles, and is believed when pictures of it at rest
agree. Errors are taken of where the robot will come to rest when stopped now (its pose and the coasting of its wheels), so
that neither the camera's lateness nor the wheels' lag makes it overshoot.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Literal, NamedTuple

from schemas import Track
from services.robot.link import Measurement
from services.robot.pose_estimate import Place, PoseEstimate, moved
from services.robot.settings import Control, Wheels
from services.robot.wheel_model import WheelModel
from vantage.service import SECOND

Result = Literal["completed", "refused", "stuck", "timed-out", "stopped", "lost"]

REACHED = 0.0003
"""m along the way at which driving at the target ends."""
LOOK_AHEAD = 0.010
"""m: nearer to the target than this, the robot steers no harder."""
NEAREST = 0.0005
"""m: nearer than this, a precise target has no direction to face."""
FACING = math.radians(4.0)
"""rad: facing the target within this, the robot drives at it; ..."""
ASTRAY = math.radians(20.0)
"""... beyond this it stops and faces it again."""
UNEVEN = 2.0
"""Times by which lines come unevenly, that `response` is longer."""
SLOW_TURN = 2.0
"""Times `response` in which steering errors are driven out while driving."""
MANOEUVRE = int(0.9 * SECOND)
"""ns that a robot needs to turn, drive sideways and turn back: with less left it is not begun."""
STUCK_WAY = 0.006
"""m of the wheels of which the robot must show a part, or it is stuck; ..."""
STUCK_SHARE = 0.35
"""... this part; ..."""
STUCK_TIME = int(0.4 * SECOND)
"""... within this time, ns."""
ENDING = int(0.5 * SECOND)
"""ns that a motion that failed waits for the robot to rest and be seen, at most."""


class Target(NamedTuple):
    """Where a robot is to be.

    Attributes:
        x, y: m, arena frame.
        heading: rad; None: any.
        gear: +1 drives there forwards, -1 backwards, 0: only what turning on the spot leaves is corrected.
        precise: whether it must come to rest there within tolerance; else passing within `near` is enough.
        near: m.
        patience: s after which it is given up.
    """

    x: float
    y: float
    heading: float | None
    gear: int
    precise: bool
    near: float
    patience: float


@dataclass(frozen=True, slots=True)
class Ended:
    """How a motion ended; errors (m, rad: tracked minus wanted) of the tracked pose at rest."""

    result: Result
    distance_error: float
    heading_error: float
    reason: str = ""


class _Phase(Enum):
    IDLE = 0
    FACE = 1
    DRIVE = 2
    ALIGN = 3
    SETTLE = 4
    ENDING = 5


class MotionControl:
    """See module. Feed it what the robot measures and where it is tracked; `step` it to get wheel speeds (m/s) or an end.

    Attributes:
        estimate: where the robot is.
    """

    def __init__(self, wheels: Wheels, control: Control) -> None:
        self.estimate = PoseEstimate(wheels, control)
        self._wheels = wheels
        self._control = control
        self._model = WheelModel(wheels)
        self._latency = int(wheels.line_latency * SECOND)
        self._phase = _Phase.IDLE
        self._target = Target(0.0, 0.0, None, 0, True, 0.0, 0.0)
        self._gear = 1
        self._deadline = self._latest = 0
        self._begun = self._stepped = 0
        self._awake = 0  # since when (ns) the driver has run without being held up
        self._pending: Result = "completed"
        self._reason = ""
        self._window: deque[tuple[Track, float, float]] = deque(maxlen=32)
        self._speed = control.speed

    @property
    def busy(self) -> bool:
        """Whether a motion is under way."""
        return self._phase is not _Phase.IDLE

    def begin(self, target: Target, now: int, speed: float | None = None) -> None:
        """Begin a motion; `speed` of a wheel at most, m/s."""
        self._target = target
        self._gear = target.gear
        self._speed = self._control.speed if speed is None else speed
        self._begun = self._stepped = now
        self._deadline = now + int(target.patience * SECOND)
        self._latest = self._deadline + int(self._control.blind * SECOND)
        self._window.clear()
        self._pending, self._reason = "completed", ""
        self._phase = _Phase.FACE if target.gear else _Phase.ALIGN

    def cancel(self) -> None:
        """End the motion unreported; the caller stops the wheels."""
        self._phase = _Phase.IDLE

    def fail(self, result: Result, reason: str, now: int) -> None:
        """Give the motion up: the wheels stop, `step` reports it when the robot rests."""
        if self._phase not in (_Phase.IDLE, _Phase.ENDING):
            self._phase = _Phase.ENDING
            self._pending, self._reason = result, reason
            self._deadline = now + ENDING

    def held_up(self, lag: int, now: int) -> None:
        """Do not count `lag` ns in which the driver did not run, up to `now`: no time to drive, and no pictures to miss."""
        self._awake = now
        self._deadline += lag
        self._latest += lag
        self._stepped += lag

    def measure(self, measurement: Measurement) -> None:
        """Take what the encoders counted."""
        stamp, taken, left, right = measurement
        self.estimate.measure(stamp - self._latency, left, right)
        per_tick = self._wheels.metres_per_tick
        self._model.measure(stamp, taken, left * per_tick, right * per_tick)

    def told(self, sequence: int, left: float, right: float, now: int) -> None:
        """Take note of the speeds (m/s) that the line of this number has sent."""
        self._model.tell(sequence, left, right, now)

    def see(self, track: Track, now: int) -> None:
        """Take a tracked pose, its stamp of the own clock; finds out whether the robot is stuck."""
        self.estimate.see(track)
        turned = self.estimate.wheels_at(track.stamp) if track.seen else None
        if turned is None or self._phase in (_Phase.IDLE, _Phase.ENDING):
            return
        self._window.append((track, *turned))
        while track.stamp - self._window[0][0].stamp > STUCK_TIME:
            self._window.popleft()
        before, left, right = self._window[0]
        left, right = turned[0] - left, turned[1] - right
        way = 0.5 * (abs(left + right) + abs(right - left))
        shown = math.hypot(track.x - before.x, track.y - before.y)
        shown += 0.5 * self._wheels.axle_track * abs(math.remainder(track.heading - before.heading, math.tau))
        if way > STUCK_WAY and shown < STUCK_SHARE * way:
            reason = f"the wheels turned by {1000 * way:.0f} mm, the robot by {1000 * shown:.0f} mm: something is in its way"
            self.fail("stuck", reason, now)

    def step(self, now: int) -> tuple[float, float] | Ended:
        """Return speeds of the left and right wheel, m/s, or how the motion ended. Call it about every 20 ms."""
        if self._phase is _Phase.IDLE:
            return 0.0, 0.0
        place = self.estimate.place
        seen = self.estimate.seen
        unseen = now - max(self._begun, self._awake, seen or 0)
        stale = seen is None or now - seen > self._control.unseen * SECOND
        if self._phase is not _Phase.ENDING and (stale or place is None):
            # The time without sight does not count, up to a limit: others wait for the end of the step.
            self._deadline = min(self._deadline + now - self._stepped, self._latest)
            if unseen > self._control.lost * SECOND or now >= self._latest:
                self.fail("lost", f"not seen by the overhead camera for {unseen / SECOND:.1f} s", now)
            self._stepped = now
            return 0.0, 0.0
        self._stepped = now
        if self._phase is not _Phase.ENDING and now >= self._deadline:
            self.fail("timed-out", f"not there within {self._target.patience:g} s", now)
        if self._phase is _Phase.ENDING:
            return self._end(now)
        assert place is not None
        left, right = self._model.coast(now)
        coming = moved(place, 0.5 * (left + right), (right - left) / self._wheels.axle_track)
        ahead, turn = self._steer(coming)
        if self._phase is _Phase.SETTLE:
            if not self._target.precise:
                return self._finish("completed")
            settled = self._settled(now)
            if settled is not None:
                return settled
        return self._wheel_speeds(ahead, turn)

    def _steer(self, place: Place) -> tuple[float, float]:
        """Return speed (m/s) and turn rate (rad/s) for where the robot comes to rest, and turn to the next phase."""
        control, target = self._control, self._target
        # A speed that may hold longer than meant must drive out less than all of the error in that time.
        response = control.response + UNEVEN * self._model.uneven
        ahead, beside = _in_robot_frame(place, target)
        distance = math.hypot(ahead, beside)
        if self._phase in (_Phase.FACE, _Phase.DRIVE) and not target.precise and distance < target.near:
            self._phase = _Phase.SETTLE
        if self._phase is _Phase.FACE:
            off = math.atan2(self._gear * beside, self._gear * ahead)
            if abs(off) > FACING and distance > (NEAREST if target.precise else target.near):
                return 0.0, off / response
            self._phase = _Phase.DRIVE
        if self._phase is _Phase.DRIVE:
            left = self._gear * ahead
            off = math.atan2(self._gear * beside, max(left, LOOK_AHEAD))
            if left > REACHED:
                if abs(off) > ASTRAY and distance > LOOK_AHEAD:
                    self._phase = _Phase.FACE
                    return 0.0, off / response
                return self._gear * left / response, off / (SLOW_TURN * response)
            self._phase = _Phase.ALIGN if target.precise else _Phase.SETTLE
        if self._phase is _Phase.ALIGN:
            turn = 0.0 if target.heading is None else math.remainder(target.heading - place.heading, math.tau)
            if abs(turn) > 0.5 * control.heading_aim or abs(ahead) > 0.5 * control.distance_aim:
                return ahead / response, turn / response
            self._phase = _Phase.SETTLE
        return 0.0, 0.0

    def _settled(self, now: int) -> Ended | None:
        """Judge a robot that should stand still: done, or what is left must be corrected."""
        estimate, control, target = self.estimate, self._control, self._target
        place = estimate.place
        if estimate.rest is None or place is None or not self._model.told_to_rest:
            return None
        ahead, beside = _in_robot_frame(place, target)
        _, turn = _errors(place, target)
        if abs(beside) > control.beside_aim and self._deadline - now < MANOEUVRE:
            if estimate.frames_at_rest >= control.frames:
                self.fail("timed-out", f"{1000 * abs(beside):.1f} mm beside its target, too late to correct that", now)
        elif abs(beside) > control.beside_aim:
            # Wheels do not go sideways: turn, drive, turn back.
            self._gear = 1 if ahead >= 0.0 else -1
            self._phase = _Phase.FACE
        elif abs(ahead) > control.distance_aim or abs(turn) > control.heading_aim:
            self._phase = _Phase.ALIGN
        elif estimate.frames_at_rest >= control.frames:
            return self._finish("completed")
        return None

    def _end(self, now: int) -> tuple[float, float] | Ended:
        """Wait until a robot that failed rests and is seen; then say how it ended: there after all, or not."""
        resting = self.estimate.rest is not None and self._model.told_to_rest
        rested = resting and self.estimate.frames_at_rest >= self._control.frames
        if not rested and now < self._deadline and self._pending in ("stuck", "timed-out"):
            return 0.0, 0.0
        place = self.estimate.place
        if rested and place is not None and self._pending in ("stuck", "timed-out") and self._target.precise:
            distance, turn = _errors(place, self._target)
            if distance <= self._control.distance_tolerance and abs(turn) <= self._control.heading_tolerance:
                return self._finish("completed")
        return self._finish(self._pending)

    def _finish(self, result: Result) -> Ended:
        self._phase = _Phase.IDLE
        place = self.estimate.place
        distance, turn = (0.0, 0.0) if place is None else _errors(place, self._target)
        return Ended(result, min(distance, 100.0), turn, "" if result == "completed" else self._reason)

    def _wheel_speeds(self, ahead: float, turn: float) -> tuple[float, float]:
        """Return both wheels' speeds, none too fast: turning comes first, or a robot in a hurry would not steer."""
        beside = min(max(0.5 * self._wheels.axle_track * turn, -self._speed), self._speed)
        most = self._speed - abs(beside)
        ahead = min(max(ahead, -most), most)
        return round(ahead - beside, 3), round(ahead + beside, 3)  # as the line carries them


def _in_robot_frame(place: Place, target: Target) -> tuple[float, float]:
    """Return how far the target lies ahead and to the left of a robot at a place, m."""
    cosine, sine = math.cos(place.heading), math.sin(place.heading)
    x, y = target.x - place.x, target.y - place.y
    return cosine * x + sine * y, cosine * y - sine * x


def _errors(place: Place, target: Target) -> tuple[float, float]:
    """Return the distance (m) and the heading error (rad, tracked minus wanted)."""
    turn = 0.0 if target.heading is None else math.remainder(place.heading - target.heading, math.tau)
    return math.hypot(place.x - target.x, place.y - target.y), turn
