"""A robot's pose over time: a Kalman filter of constant velocity, which says when it predicts rather than sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vantage.tracking.tag_pose import wrapped

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FilterSettings:
    """How robots may move."""

    acceleration: float = 2.0
    """standard deviation of a robot's acceleration along each axis, m/s^2"""
    turn_acceleration: float = 30.0
    """standard deviation of a robot's angular acceleration, rad/s^2"""
    first_speed: float = 0.3
    """standard deviation of the speed of a robot just found, m/s"""
    first_turn_rate: float = 3.0
    """standard deviation of the turn rate of a robot just found, rad/s"""
    gate: float = 30.0
    """greatest squared Mahalanobis distance of a pose that is believed (3 degrees of freedom: 16 is exceeded once in 1,000)"""
    refused_in_a_row: int = 3
    """so many disbelieved poses start the filter anew: the robot was carried elsewhere"""
    forget_after: float = 0.5
    """s without a believed pose until the track ends"""


@dataclass(frozen=True, slots=True)
class TrackState:
    """Where a robot is.

    Attributes:
        x: centre, m, arena frame.
        y: centre, m, arena frame.
        heading: rad, counter-clockwise from +x, within pi of 0.
        speed_x: m/s.
        speed_y: m/s.
        turn_rate: rad/s.
        covariance: xx, xy, xh, yy, yh, hh in m and rad.
        seen: False: predicted, the tag was not seen in this picture.
        stamp: of the picture, ns.
    """

    x: float
    y: float
    heading: float
    speed_x: float
    speed_y: float
    turn_rate: float
    covariance: tuple[float, float, float, float, float, float]
    seen: bool
    stamp: int


class PoseFilter:
    """The track of one robot: `predict` to each picture's stamp, then `correct` with what was seen in it.

    State: x, y, heading and their rates, with one joint covariance (Kalman filter, white acceleration between pictures).
    """

    def __init__(self, settings: FilterSettings | None = None) -> None:
        self.settings = settings or FilterSettings()
        self._state: Floats = np.zeros(6)
        self._covariance: Floats = np.zeros((6, 6))
        self._stamp = 0
        self._last_seen = 0
        self._alive = False
        self._seen = False
        self._refused = 0

    @property
    def alive(self) -> bool:
        """Whether there is a track."""
        return self._alive

    @property
    def pose(self) -> Floats:
        """x, y, heading, float64 [3]; of no meaning without a track."""
        return self._state[:3]

    @property
    def spread(self) -> float:
        """Standard deviation of the place, m, along its worst axis at most."""
        return float(np.sqrt(self._covariance[0, 0] + self._covariance[1, 1]))

    @property
    def state(self) -> TrackState | None:
        """The track at the last picture, None without one."""
        if not self._alive:
            return None
        x, y, heading, speed_x, speed_y, turn_rate = (float(value) for value in self._state)
        c = self._covariance
        covariance = tuple(float(value) for value in (c[0, 0], c[0, 1], c[0, 2], c[1, 1], c[1, 2], c[2, 2]))
        assert len(covariance) == 6
        return TrackState(x, y, wrapped(heading), speed_x, speed_y, turn_rate, covariance, self._seen, self._stamp)

    def end(self) -> None:
        """End the track: the next pose begins a new one."""
        self._alive = self._seen = False

    def predict(self, stamp: int) -> None:
        """Move on to a picture's stamp, ns. A track unseen for too long ends, and so does one of a clock that went backwards."""
        self._seen = False
        if not self._alive:
            return
        if stamp < self._stamp or stamp - self._last_seen > self.settings.forget_after * 1e9:
            self._alive = False
            return
        passed = (stamp - self._stamp) * 1e-9
        self._stamp = stamp
        step = np.eye(6)
        step[0, 3] = step[1, 4] = step[2, 5] = passed
        variance = np.array([self.settings.acceleration, self.settings.acceleration, self.settings.turn_acceleration]) ** 2
        noise = np.zeros((6, 6))
        place = np.arange(3)
        noise[place, place] = variance * passed**4 / 4
        noise[place, place + 3] = noise[place + 3, place] = variance * passed**3 / 2
        noise[place + 3, place + 3] = variance * passed**2
        self._state = step @ self._state
        self._covariance = step @ self._covariance @ step.T + noise

    def correct(self, pose: Floats, covariance: Floats, stamp: int) -> bool:
        """Take a measured pose float64 [3] with its covariance float64 [3, 3]; returns whether it was believed."""
        if not self._alive:
            self._begin(pose, covariance, stamp)
            return True
        difference = pose - self._state[:3]
        difference[2] = wrapped(float(difference[2]))
        inverse = np.linalg.inv(self._covariance[:3, :3] + covariance)
        if float(difference @ inverse @ difference) > self.settings.gate:
            self._refused += 1
            if self._refused < self.settings.refused_in_a_row:
                return False
            self._begin(pose, covariance, stamp)
            return True
        gain = self._covariance[:, :3] @ inverse
        self._state = self._state + gain @ difference
        self._state[2] = wrapped(float(self._state[2]))
        kept = np.eye(6)
        kept[:, :3] -= gain
        # Joseph's form stays symmetric and positive.
        self._covariance = kept @ self._covariance @ kept.T + gain @ covariance @ gain.T
        self._seen, self._last_seen, self._refused = True, stamp, 0
        return True

    def _begin(self, pose: Floats, covariance: Floats, stamp: int) -> None:
        self._state = np.concatenate((pose, np.zeros(3)))
        self._covariance = np.zeros((6, 6))
        self._covariance[:3, :3] = covariance
        speeds = (self.settings.first_speed, self.settings.first_speed, self.settings.first_turn_rate)
        self._covariance[3:, 3:] = np.diag(np.square(speeds))
        self._stamp = self._last_seen = stamp
        self._alive = self._seen = True
        self._refused = 0
