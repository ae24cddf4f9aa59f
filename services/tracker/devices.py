"""Overhead cameras as devices: V4L2 and USB cameras, video files, folders of pictures. Frames are uint8 [H, W, 3] RGB."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from vantage.service import SECOND, DeviceLost, steady_clock
from vantage.tracking.picture_file import open_video, read_pixels
from vantage.tracking.video_capture import FOURCC, RATE, CameraMode, UnusableCamera, open_camera

Frame = tuple[npt.NDArray[np.uint8], int]

WAIT = 0.2
"""Seconds that a read waits at most for a frame that is not due yet."""


@dataclass(frozen=True)
class OverheadSettings:
    """How the overhead camera is driven. What the camera does not do is refused, not passed over."""

    overhead_width: int = 1280
    """pixels; the calibration holds for one resolution"""
    overhead_height: int = 720
    """pixels"""
    overhead_rate: float | None = None
    """frames a second; None: 30, a video file's own. Of a video file or a folder, 0 = as fast as they are read"""
    overhead_exposure: float | None = None
    """exposure time in the camera's own unit (V4L2: 100 us); None: automatic. Short is sharp while robots move"""
    overhead_fourcc: str = FOURCC
    """pixel format asked of the camera: four letters"""
    overhead_latency: float = 0.03
    """seconds from the exposure to the frame, subtracted where the camera's driver does not stamp its frames"""

    @property
    def mode(self) -> CameraMode:
        """What is asked of a camera."""
        rate = self.overhead_rate or RATE
        return CameraMode(self.overhead_width, self.overhead_height, rate, self.overhead_fourcc, self.overhead_exposure)


class DrivenCamera:
    """A V4L2 or USB camera, by number or path, set up and read back."""

    newest_only = True

    def __init__(self, name: str, source: str, settings: OverheadSettings) -> None:
        self.name = name
        self._source, self._settings = source, settings
        self._capture: Any = None

    def open(self) -> None:
        try:
            self._capture = open_camera(self._source, self._settings.mode)
        except UnusableCamera as error:
            raise DeviceLost(f"{self.name}: {error}") from error

    def read(self) -> Frame | None:
        if not self._capture.grab():
            raise DeviceLost(f"{self.name}: {self._source} gives no frames any more: look at its cable")
        stamp = self._stamp()
        there, picture = self._capture.retrieve()
        if not there:
            return None  # a damaged frame
        return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), stamp

    def _stamp(self) -> int:
        """The driver's own stamp of the exposure (V4L2 stamps on the monotonic clock), else now less the latency."""
        now = steady_clock()
        age = time.monotonic() - self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
        return now - int((age if 0.0 <= age < 1.0 else self._settings.overhead_latency) * SECOND)

    def write(self, data: bytes) -> None:
        raise NotImplementedError("nothing is written to a camera")

    def close(self) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None


class PacedFrames:
    """A recording, given out at its pace: a frame is stamped with the time at which its turn comes. Its end is a lost device.

    Subclasses say where frames come from, and set `_turn` before they yield a frame that comes at a time of its own.
    """

    newest_only = True

    def __init__(self, name: str, source: Path, rate: float) -> None:
        self.name = name
        self._source = source
        self._period = 1.0 / rate if rate > 0 else 0.0
        self._frames: Iterator[Any] | None = None
        self._next: Any = None  # the frame whose turn comes next
        self._turn = 0.0  # when, s after the first
        self._began = 0  # when the first frame's was, ns
        self._ended = False

    def frames(self) -> Iterator[Any]:
        """Yield the frames in order. Raises DeviceLost or OSError when they cannot be read."""
        raise NotImplementedError

    def open(self) -> None:
        if self._ended:
            raise DeviceLost(f"{self.name}: {self._source} has ended")
        if not self._source.exists():
            raise DeviceLost(f"{self.name}: there is no {self._source}")
        self._frames, self._next, self._turn = self.frames(), None, 0.0
        self._began = steady_clock()

    def read(self) -> tuple[Any, int] | None:
        assert self._frames is not None
        if self._next is None:
            self._next = next(self._frames, None)
        if self._next is None:
            self._ended = True
            raise DeviceLost(f"{self.name}: {self._source} has ended")
        due = self._began + int(self._turn * SECOND)
        early = (due - steady_clock()) / SECOND
        if early > 0:
            time.sleep(min(early, WAIT))
            if early > WAIT:
                return None
        elif early < -WAIT or not self._turn:
            # Who cannot keep its pace goes on from now, at its pace.
            self._began += int(-early * SECOND)
            due = self._began + int(self._turn * SECOND)
        frame, self._next = self._next, None
        self._turn += self._period
        return frame, due

    def write(self, data: bytes) -> None:
        raise NotImplementedError("nothing is written to a recording")

    def close(self) -> None:
        self._frames = None


class VideoFile(PacedFrames):
    """A video file, each frame at its own time (a video may have no rate) unless told otherwise."""

    def __init__(self, name: str, source: Path, rate: float | None = None) -> None:
        super().__init__(name, source, rate or 0.0)
        self._own_times = rate is None

    def frames(self) -> Iterator[npt.NDArray[np.uint8]]:
        capture = open_video(self._source)
        try:
            if not capture.isOpened():
                raise DeviceLost(f"{self.name}: {self._source} is no video that OpenCV reads")
            rate, last = max(capture.get(cv2.CAP_PROP_FPS), 1.0), -1.0
            while True:
                there, picture = capture.read()
                if not there:
                    return
                if self._own_times:
                    at = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
                    self._turn = last = at if at > last else last + 1.0 / rate
                yield cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
        finally:
            capture.release()


class PictureFolder(PacedFrames):
    """A folder of PNG or JPEG pictures, in the order of their names."""

    def frames(self) -> Iterator[npt.NDArray[np.uint8]]:
        paths = sorted(path for path in self._source.iterdir() if path.suffix.lower() in (".png", ".jpg", ".jpeg"))
        if not paths:
            raise DeviceLost(f"{self.name}: {self._source} holds no PNG or JPEG pictures")
        for path in paths:
            picture = read_pixels(path)
            if picture is None:
                raise DeviceLost(f"{self.name}: {path} is no picture that OpenCV reads")
            yield picture
