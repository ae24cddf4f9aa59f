"""The numbers of the robots and of how they are driven."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from vantage.drive.protocol import BAUD

NO_PORT = "none"


@dataclass(frozen=True)
class Wheels:
    """A robot's wheels, as measured with a ruler; a per cent or two of error does no harm."""

    axle_track: float = 0.090
    """m between the wheels' contact points"""
    wheel_radius: float = 0.016
    """m"""
    ticks_per_turn: int = 1440
    """encoder ticks of one turn of a wheel"""
    lag: float = 0.035
    """s, time constant with which a wheel's speed follows what it is told"""
    line_latency: float = 0.007
    """s from sending a line to the wheels' taking it, and from a measurement to its arrival here"""

    def __post_init__(self) -> None:
        if min(self.axle_track, self.wheel_radius, self.ticks_per_turn) <= 0 or min(self.lag, self.line_latency) < 0:
            raise ValueError("axle_track, wheel_radius and ticks_per_turn must be above 0, lag and line_latency not below 0")

    @property
    def metres_per_tick(self) -> float:
        return math.tau * self.wheel_radius / self.ticks_per_turn


@dataclass(frozen=True)
class Control:
    """How a motion is controlled, and when it counts as done."""

    speed: float = 0.150
    """m/s of a wheel at most, in steps of a game"""
    placing_speed: float = 0.200
    """m/s of a wheel at most, while robots drive to their starts"""
    response: float = 0.022
    """s in which an error is driven out; below the time between two telemetry lines it overshoots"""
    distance_tolerance: float = 0.002
    """m: farther from the target than this, a motion has not completed"""
    heading_tolerance: float = math.radians(2.0)
    """rad: the same"""
    distance_aim: float = 0.0010
    """m: nearer than this to the target along its heading, a robot corrects nothing more"""
    beside_aim: float = 0.0016
    """m: the same beside it; to correct this, a robot must turn, drive and turn back"""
    heading_aim: float = math.radians(0.9)
    """rad: the same"""
    frames: int = 2
    """pictures of the robot at rest that must agree before a motion counts as done"""
    patience: float = 1.5
    """s after which a motion is given up"""
    unseen: float = 0.5
    """s without being seen after which a moving robot stops"""
    lost: float = 2.0
    """s without being seen after which a motion is given up"""
    blind: float = 0.5
    """s of not being seen that do not count as patience, at most; with it and the end a step of a game takes 2.5 s at most, and
    the referee waits 10 s for the poses"""
    track_distance: float = 0.0005
    """m, standard deviation of a tracked place, at least"""
    track_heading: float = math.radians(0.2)
    """rad, standard deviation of a tracked heading, at least"""
    low_battery: float = 6.4
    """V below which the battery is to be charged"""


@dataclass(frozen=True)
class RobotSettings:
    """Where the robots are and how they are driven."""

    hider_port: str = NO_PORT
    """Serial port of the hider, such as /dev/serial/by-id/...; none: somebody else drives it."""
    seeker_port: str = NO_PORT
    """Serial port of the seeker; none: somebody else drives it."""
    baud: int = BAUD
    """Bits a second of both ports."""
    wheels: Wheels = field(default_factory=Wheels)
    control: Control = field(default_factory=Control)
    silence: float = 0.5
    """Seconds without acknowledgement or telemetry after which a robot does not answer, and its motion is given up. Longer for
    robots that are programs on this machine, which may be starved."""
    settle: float = 0.3
    """Seconds to listen after the start, to hear of a step that a crashed driver left behind."""

    def port_of(self, robot: str) -> str:
        """Return a robot's port, or NO_PORT."""
        return self.hider_port if robot == "hider" else self.seeker_port
