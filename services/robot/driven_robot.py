"""One robot with a serial line: its link and its motion control together, stepped by what the robot says and by time."""

from __future__ import annotations

from schemas import Track
from services.robot.link import DAMAGED_SHARE, Link
from services.robot.motion_control import Ended, MotionControl, Target
from services.robot.settings import RobotSettings
from vantage.service import SECOND, Captured, Send

SENDING = SECOND // 20
"""ns after which the speeds are sent again at the latest, while the robot moves: lost lines do no harm."""
IDLING = SECOND // 10
"""ns between two lines to a robot that stands still: it answers, so it is known to be there."""


class DrivenRobot:
    """See module.

    Attributes:
        link, control: its parts.
    """

    def __init__(self, robot: str, settings: RobotSettings) -> None:
        self.link = Link(robot, settings.port_of(robot), settings.silence)
        self.control = MotionControl(settings.wheels, settings.control)
        self._low_battery = settings.control.low_battery

    def wake_at(self) -> int:
        """Return when the next line is due, ns."""
        if self.link.last_sent is None:
            return 0
        return self.link.last_sent + (SENDING if self.control.busy else IDLING)

    def begin(self, target: Target, now: int, speed: float | None = None) -> None:
        """Begin a motion; `advance` reports its end."""
        self.control.begin(target, now, speed)

    def halt(self, now: int) -> list[Send]:
        """End the motion unreported and stop the wheels."""
        self.control.cancel()
        return [self._send(0.0, 0.0, now)]

    def held_up(self, lag: int, now: int) -> None:
        """Do not count `lag` ns in which the driver did not run, up to `now`: neither robot nor camera was silent then."""
        self.link.held_up(lag)
        self.control.held_up(lag, now)

    def see(self, track: Track, now: int) -> None:
        """Take a tracked pose, its stamp of the own clock."""
        self.control.see(track, now)

    def hear(self, captured: Captured, now: int) -> tuple[list[Send], Ended | None]:
        """Take what came through the port; see `advance`."""
        if captured.error:
            self.link.unplugged = captured.error
            return self._fail_if_helpless(now)
        if captured.value is None:
            self.link.opened(now)
            return [], None
        measurements = self.link.hear(captured.value, captured.stamp)
        for measurement in measurements:
            self.control.measure(measurement)
        return self.advance(now) if measurements and self.control.busy else ([], None)

    def advance(self, now: int) -> tuple[list[Send], Ended | None]:
        """Let time pass: return the line to send, and how the motion ended if it did."""
        sends, ended = self._fail_if_helpless(now)
        if ended is not None:
            return sends, ended
        if not self.control.busy:
            return [self._send(0.0, 0.0, now)], None
        outcome = self.control.step(now)
        if isinstance(outcome, Ended):
            return [self._send(0.0, 0.0, now)], outcome
        return [self._send(*outcome, now)], None

    def clear(self, now: int) -> list[Send]:
        """Clear a latched emergency stop if a person has asked for a game since."""
        return [self.link.clear(now)] if self.link.may_clear else []

    def trouble(self, now: int) -> str:
        """Return what is wrong, for people; empty when nothing."""
        link = self.link
        trouble = link.trouble(now)
        if trouble:
            return trouble
        told = []
        if link.damaged > DAMAGED_SHARE:
            told.append(f"robot {link.robot}: {link.damaged:.0%} of its lines come damaged; look at its cable, or at its radio")
        if link.battery is not None and (link.low_battery or link.battery < self._low_battery):
            told.append(f"robot {link.robot}: battery at {link.battery:.1f} V, charge it")
        return "; ".join(told)

    def _send(self, left: float, right: float, now: int) -> Send:
        line = self.link.set_speeds(left, right, now) if self.control.busy else self.link.stop(now)
        self.control.told(self.link.sequence, left, right, now)
        return line

    def _fail_if_helpless(self, now: int) -> tuple[list[Send], Ended | None]:
        """End a motion that nobody can carry out: no line to the robot, or an emergency stop."""
        reason = self.link.trouble(now)
        if not (reason and self.control.busy):
            return [], None
        self.control.fail("stopped", reason, now)
        outcome = self.control.step(now)
        return [self._send(0.0, 0.0, now)], outcome if isinstance(outcome, Ended) else None
