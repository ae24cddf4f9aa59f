"""Real cameras as a pure core: overhead frames to tracks and layout; frames after each motion to the step's poses and pictures.

A frame comes from a device of this process (`Captured`) or from the bus (`Arrived`), to the core it is the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from schemas import ROBOTS, ColorImage, DepthImage, Episode, Message, Motion, Tick, Track
from services.tracker.capture import Picture, RawFrame, StepCapture
from services.tracker.declaration import DECLARATION
from services.tracker.table_layout import TableLayout
from services.tracker.watch import PATIENCE_AT_REST, CameraWatch
from vantage.service import SECOND, Arrived, Captured, Publish, Received, Send, SenderClock, StepJoin, Unexpected
from vantage.tracking.calibration import Calibration
from vantage.tracking.overhead import OverheadTracker, TrackState
from vantage.tracking.rgbd import RgbdCalibration, RgbdPreparer
from vantage.tracking.table import Table

CHECK_PERIOD = SECOND // 4
LAYOUT_PERIOD = 2 * SECOND
"""While robots drive to their starts the layout is said again and again: each time renews the referee's patience."""
OLDEST_MOTION = SECOND // 2
"""ns that a driver's report may take; of one that took longer, nobody can tell when the robot came to rest."""
RESUMING = 3 * SECOND // 10
"""A tracker that comes into a running game waits so long for the tick that tells it which step is out already."""

OVERHEAD = "overhead camera"
CALIBRATION = "calibration"
"""Names of devices; the robots' are `hider camera` and `seeker camera`."""


class Calibrated(NamedTuple):
    """The table and its cameras, as the set-up measured them."""

    table: Table
    overhead: Calibration
    robots: dict[str, RgbdCalibration]


@dataclass(frozen=True)
class TrackerSettings:
    """Pictures for the players, and how long cameras may be silent."""

    width: int = 160
    """of the published pictures, pixels"""
    height: int = 120
    """of the published pictures, pixels"""
    camera_patience: float = 1.0
    """Seconds without a frame, or without a robot's tag in it, after which health names the camera in a running game."""


class TrackerCore:
    """See module."""

    declaration = DECLARATION

    def __init__(self, calibrated: Calibrated, settings: TrackerSettings | None = None) -> None:
        self._settings = settings or TrackerSettings()
        self.trouble = ""
        self._episode: Episode | None = None
        self._step = 0
        self._motions = StepJoin(tuple(f"{robot}/motion" for robot in ROBOTS))
        self._capture: StepCapture | None = None
        self._failure = ""
        self._layout_due: int | None = None
        self._resumed = 0  # until when (ns) motions are put aside
        self._put_aside: tuple[Message, ...] | None = None
        self._ticked = (0, -1)  # episode and step of the latest tick: the step's poses are out
        self._clocks: dict[str, SenderClock] = {}  # of who speaks on the bus, by key
        self._halves: dict[str, dict[type[Message], Any]] = {robot: {} for robot in ROBOTS}
        self._cameras = CameraWatch((OVERHEAD, *(f"{robot} camera" for robot in ROBOTS)), "no frame")
        self._troubles_seen: tuple[str, ...] = ()
        self._calibration_trouble = ""
        self._check_at = 0
        self._calibrate(calibrated)

    def _calibrate(self, calibrated: Calibrated) -> None:
        self._calibrated = calibrated
        self._overhead = OverheadTracker(calibrated.table, calibrated.overhead)
        self._layout = TableLayout(calibrated.table)
        self._tracks: tuple[int, dict[str, TrackState | None]] = (0, {})
        self._frames: dict[str, RawFrame] = {}
        tags = calibrated.table.robots
        self._tag_names: dict[str, str] = {robot: f"{robot}'s tag {tags[robot].id}" for robot in ROBOTS}
        self._tags = CameraWatch(self._tag_names.values(), "not seen from above")
        size = (self._settings.width, self._settings.height)
        self._preparers: dict[str, RgbdPreparer] = {robot: RgbdPreparer(calibrated.robots[robot], *size) for robot in ROBOTS}
        self._calibration_trouble = ""

    def wake_at(self) -> int | None:
        return self._check_at if self._put_aside is None else min(self._check_at, self._resumed)

    def step(self, received: Received, now: int) -> Sequence[Send]:
        if isinstance(received, Arrived):
            return self._on_message(received, now)
        if isinstance(received, Captured):
            return self._on_captured(received, now)
        return self._on_time(now)

    def held_up(self, lag: int, now: int) -> None:
        """Do not count `lag` ns in which the tracker did not run against the cameras."""
        self._cameras.held_up(lag)
        self._tags.held_up(lag)

    def _own_time(self, arrived: Arrived, now: int) -> int | None:
        """Return when a message was stamped, by the own clock; None where it is not a new one."""
        clock = self._clocks.setdefault(arrived.key, SenderClock())
        return clock.take(arrived.message.stamp, arrived.published, now)

    def _on_message(self, arrived: Arrived, now: int) -> Sequence[Send]:
        key, message = arrived.key, arrived.message
        robot = key.partition("/")[0]
        if isinstance(message, Episode):
            return self._on_episode(message, now)
        if isinstance(message, Motion):
            return self._on_motion(arrived, message, now)
        if isinstance(message, Tick):
            return self._on_tick(message)
        if isinstance(message, DepthImage):
            return self._on_half(robot, arrived, _depth_of(message), now)
        if isinstance(message, ColorImage):
            if key == "overhead/color":
                taken = self._own_time(arrived, now)
                return () if taken is None else self._on_overhead(_color_of(message), taken, now)
            return self._on_half(robot, arrived, _color_of(message), now)
        return ()

    def _on_captured(self, captured: Captured, now: int) -> Sequence[Send]:
        name = captured.device
        if name == CALIBRATION:
            if captured.value is None:
                self._calibration_trouble = captured.error
            else:
                self._calibrate(captured.value)
            return ()
        if captured.value is None:
            if captured.error:  # else it has been opened
                self._cameras.lost(name, captured.error)
                self._say_trouble(now)
            return ()
        if name == OVERHEAD:
            return self._on_overhead(captured.value, captured.stamp, now)
        depth, color = captured.value
        return self._on_frame(name.partition(" ")[0], RawFrame(captured.stamp, depth, color), now)

    def _on_half(self, robot: str, arrived: Arrived, array: Any, now: int) -> Sequence[Send]:
        """Depth and colour of one capture travel apart: they belong together by their stamp, whatever order they come in."""
        taken = self._own_time(arrived, now)
        if taken is None:
            return ()
        halves = self._halves[robot]
        halves[type(arrived.message)] = (arrived.message.stamp, taken, array)
        if len(halves) < 2 or halves[DepthImage][0] != halves[ColorImage][0]:
            return ()
        (_, *depth), (_, *color) = halves[DepthImage], halves[ColorImage]
        return self._on_frame(robot, RawFrame(min(depth[0], color[0]), depth[1], color[1]), now)

    def _on_episode(self, episode: Episode, now: int) -> Sequence[Send]:
        known = self._episode is not None and self._episode.episode == episode.episode
        if episode.phase in ("ended", "aborted"):
            if known:
                self._episode, self._capture, self._layout_due, self._put_aside = None, None, None, None
                self._failure = ""
            return ()
        if known and episode.phase == "running":
            return ()
        # A set-up, or a running game that this process, started again, has not heard of.
        self._episode = episode
        self._step, self._capture, self._failure, self._put_aside = 0, None, "", None
        self._layout_due = now
        self._resumed = now + RESUMING if episode.phase == "running" else 0
        sends = list(self._say_layout(now))
        motions = self._motions.begin(episode.episode)
        return [*sends, *self._begin_capture(motions, now)] if motions is not None else sends

    def _on_motion(self, arrived: Arrived, motion: Motion, now: int) -> Sequence[Send]:
        ended = self._own_time(arrived, now)
        if ended is None or now - ended > OLDEST_MOTION:
            ended = now  # it ended before it was reported
        motions = self._motions.add(arrived.key, msgspec.structs.replace(motion, stamp=ended))
        return () if motions is None else self._begin_capture(motions, now)

    def _on_tick(self, tick: Tick) -> Sequence[Send]:
        """A tick follows the poses of its step: a tracker before this one has published them."""
        self._ticked = (tick.episode, tick.step)
        if self._capture is not None and self._is_out(self._capture.step):
            self._capture = None
        return ()

    def _is_out(self, step: int) -> bool:
        episode, ticked = self._ticked
        return self._episode is not None and self._episode.episode == episode and step <= ticked

    def _begin_capture(self, motions: tuple[Message, ...], now: int) -> Sequence[Send]:
        if self._episode is None:
            raise Unexpected(f"motions of episode {motions[0].episode}, which is over")
        if now < self._resumed:
            self._put_aside = motions
            return ()
        self._put_aside = None
        if self._is_out(motions[0].step):
            return ()
        self._step = motions[0].step
        failed = [
            f"{robot} {motion.result}{': ' * bool(motion.reason)}{motion.reason}"
            for robot, motion in zip(ROBOTS, motions, strict=True)
            if isinstance(motion, Motion) and motion.result in ("stopped", "lost")
        ]
        if failed:
            self._capture, self._failure = None, f"no step {self._step}: {', '.join(failed)}"
            self._layout_due = None  # the referee need not wait any longer
            self._say_trouble(now)
            return ()
        capture = StepCapture(self._episode.episode, self._step, max(motion.stamp for motion in motions))
        self._capture = capture
        # A frame taken since may have overtaken the reports.
        stamp, tracks = self._tracks
        capture.see(tracks, stamp)
        for robot, frame in self._frames.items():
            self._offer(robot, frame)
        return self._finish_capture()

    def _on_overhead(self, picture: npt.NDArray[np.uint8], stamp: int, now: int) -> Sequence[Send]:
        self._cameras.there(OVERHEAD, now)
        observation = self._overhead.observe(picture, stamp)
        self._troubles_seen = observation.troubles
        self._tracks = (stamp, dict(observation.tracks))
        place = {"episode": self._episode.episode if self._episode else 0, "step": self._step if self._episode else 0}
        sends: list[Send] = []
        for robot, track in observation.tracks.items():
            if track is None:
                continue
            if track.seen:
                self._tags.there(self._tag_names[robot], now)
            sends.append(Publish(f"{robot}/track", _message_of(track, place)))
        if self._layout.see(observation, place["episode"]):
            sends.extend(self._say_layout(now))
        if self._capture is not None:
            self._capture.see(observation.tracks, stamp)
            sends.extend(self._finish_capture())
        return sends

    def _on_frame(self, robot: str, frame: RawFrame, now: int) -> Sequence[Send]:
        camera = f"{robot} camera"
        try:
            self._preparers[robot].require(frame.depth, frame.color)
        except ValueError as error:
            self._cameras.lost(camera, str(error))
            return ()
        self._cameras.there(camera, now)
        self._frames[robot] = frame
        self._offer(robot, frame)
        return self._finish_capture()

    def _offer(self, robot: str, frame: RawFrame) -> None:
        if self._capture is not None and self._capture.wants(robot, frame.stamp):
            self._capture.look(robot, Picture(frame.stamp, *self._preparers[robot].prepare(frame.depth, frame.color)))

    def _finish_capture(self) -> Sequence[Send]:
        if self._capture is None or not self._capture.complete:
            return ()
        messages = self._capture.messages()
        self._capture = None
        self._layout_due = None  # the robots have arrived
        return messages

    def _say_layout(self, now: int) -> Sequence[Send]:
        if self._layout_due is not None:
            self._layout_due = now + LAYOUT_PERIOD
        if not self._cameras.is_fresh(OVERHEAD, now, self._settings.camera_patience):
            return ()
        layout = self._layout.message(self._tracks[0], self._episode.episode if self._episode else 0)
        return (Publish("layout", layout),) if layout is not None else ()

    def _on_time(self, now: int) -> Sequence[Send]:
        if self._put_aside is not None and now >= self._resumed:
            return self._begin_capture(self._put_aside, now)
        if now < self._check_at:
            return ()
        self._check_at = now + CHECK_PERIOD
        self._say_trouble(now)
        return self._say_layout(now) if self._layout_due is not None and now >= self._layout_due else ()

    def _say_trouble(self, now: int) -> None:
        patience = self._settings.camera_patience if self._episode is not None else PATIENCE_AT_REST
        troubles = [
            self._calibration_trouble,
            self._failure,
            self._layout.trouble,
            *self._cameras.troubles(now, patience),
        ]
        if self._cameras.is_fresh(OVERHEAD, now, patience):
            troubles += [*self._tags.troubles(now, patience), *self._troubles_seen]
        self.trouble = "; ".join(dict.fromkeys(trouble for trouble in troubles if trouble))


def _message_of(track: TrackState, place: dict[str, int]) -> Track:
    return Track(
        stamp=track.stamp,
        episode=place["episode"],
        step=place["step"],
        x=track.x,
        y=track.y,
        heading=math.remainder(track.heading, math.tau),
        speed_x=track.speed_x,
        speed_y=track.speed_y,
        turn_rate=track.turn_rate,
        covariance=track.covariance,
        seen=track.seen,
    )


def _depth_of(message: DepthImage) -> npt.NDArray[np.uint16]:
    return np.frombuffer(message.data, "<u2").reshape(message.height, message.width)


def _color_of(message: ColorImage) -> npt.NDArray[np.uint8]:
    return np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, 3)
