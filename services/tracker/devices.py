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

Frame = tuple[npt.NDArray[np.uint8], int]

WAIT = 0.2
"""Seconds that a read waits at most for a frame that is not due yet."""
_MANUAL, _AUTOMATIC = 1, 3
"""V4L2's words for who sets the exposure."""


@dataclass(frozen=True)
class OverheadSettings:
    """How the overhead camera is driven. What the camera does not do is refused, not passed over."""

    overhead_width: int = 1280
    """pixels; the calibration holds for one resolution"""
    overhead_height: int = 720
    """pixels"""
    overhead_rate: float = 30.0
    """frames a second; of a video file or a folder: its pace, 0 = as fast as they are read"""
    overhead_exposure: float | None = None
    """exposure time in the camera's own unit (V4L2: 100 us); None: automatic. Short is sharp while robots move"""
    overhead_fourcc: str = "MJPG"
    """pixel format asked of the camera: four letters"""
    overhead_latency: float = 0.03
    """seconds from the exposure to the frame, subtracted where the camera's driver does not stamp its frames"""


class DrivenCamera:
    """A V4L2 or USB camera, by number or path, set up and read back."""

    newest_only = True

    def __init__(self, name: str, source: str, settings: OverheadSettings) -> None:
        self.name = name
        self._source, self._settings = source, settings
        self._capture: Any = None

    def open(self) -> None:
        path = Path(f"/dev/video{self._source}") if self._source.isdigit() else Path(self._source)
        if not path.exists():
            raise DeviceLost(f"{self.name}: {path} is not there: plug the camera in, or see `v4l2-ctl --list-devices`")
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what goes wrong is said below, for people
        self._capture = cv2.VideoCapture(str(path), cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise DeviceLost(f"{self.name}: {path} does not open: another program has it (`fuser {path}`), or it is no camera")
        wanted = self._settings
        self._capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*wanted.overhead_fourcc))
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, wanted.overhead_width)
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, wanted.overhead_height)
        self._capture.set(cv2.CAP_PROP_FPS, wanted.overhead_rate)
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if wanted.overhead_exposure is None:
            self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _AUTOMATIC)
        else:
            self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL)
            self._capture.set(cv2.CAP_PROP_EXPOSURE, wanted.overhead_exposure)
        if refused := refusals(wanted, self._capture.get):
            raise DeviceLost(
                f"{self.name}: {path} does not do {', '.join(refused)}: see `v4l2-ctl -d {path} --list-formats-ext`, "
                "choose what it does and calibrate for it"
            )

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


def refusals(wanted: OverheadSettings, get: Any) -> list[str]:
    """Return what a camera, read back through `get(OpenCV property)`, does otherwise than asked, in words."""
    refused = []
    width, height = round(get(cv2.CAP_PROP_FRAME_WIDTH)), round(get(cv2.CAP_PROP_FRAME_HEIGHT))
    if (width, height) != (wanted.overhead_width, wanted.overhead_height):
        refused.append(f"{wanted.overhead_width} x {wanted.overhead_height} pixels (it gives {width} x {height})")
    rate = get(cv2.CAP_PROP_FPS)
    if abs(rate - wanted.overhead_rate) > 0.1 * wanted.overhead_rate:
        refused.append(f"{wanted.overhead_rate:g} frames a second (it gives {rate:g})")
    fourcc = int(get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=False).decode(errors="replace")
    if fourcc != wanted.overhead_fourcc:
        refused.append(f"the format {wanted.overhead_fourcc} (it gives {fourcc})")
    if wanted.overhead_exposure is not None:
        exposure = get(cv2.CAP_PROP_EXPOSURE)
        if abs(exposure - wanted.overhead_exposure) > 0.1 * abs(wanted.overhead_exposure) + 1e-9:
            refused.append(f"an exposure of {wanted.overhead_exposure:g} (it keeps {exposure:g})")
    return refused


class PacedFrames:
    """What was recorded, given out at its pace; `read` stamps a frame when its turn comes. When it has ended, that is said.

    Subclasses say where frames come from.
    """

    newest_only = True

    def __init__(self, name: str, source: Path, rate: float) -> None:
        self.name = name
        self._source = source
        self._period = 1.0 / rate if rate > 0 else 0.0
        self._frames: Iterator[Any] | None = None
        self._due = 0.0
        self._ended = False

    def frames(self) -> Iterator[Any]:
        """Yield the frames in order. Raises DeviceLost or OSError when they cannot be read."""
        raise NotImplementedError

    def open(self) -> None:
        if self._ended:
            raise DeviceLost(f"{self.name}: {self._source} has ended")
        if not self._source.exists():
            raise DeviceLost(f"{self.name}: there is no {self._source}")
        self._frames = self.frames()
        self._due = time.monotonic()

    def read(self) -> tuple[Any, int] | None:
        assert self._frames is not None
        early = self._due - time.monotonic()
        if early > 0:
            time.sleep(min(early, WAIT))
            if early > WAIT:
                return None
        frame = next(self._frames, None)
        if frame is None:
            self._ended = True
            raise DeviceLost(f"{self.name}: {self._source} has ended")
        self._due += self._period
        return frame, steady_clock()

    def write(self, data: bytes) -> None:
        raise NotImplementedError("nothing is written to a recording")

    def close(self) -> None:
        self._frames = None


class VideoFile(PacedFrames):
    """A video file, at its own rate unless told otherwise."""

    def __init__(self, name: str, source: Path, rate: float | None = None) -> None:
        super().__init__(name, source, rate or 0.0)
        self._own_rate = rate is None

    def frames(self) -> Iterator[npt.NDArray[np.uint8]]:
        capture = cv2.VideoCapture(str(self._source))
        try:
            if not capture.isOpened():
                raise DeviceLost(f"{self.name}: {self._source} is no video that OpenCV reads")
            if self._own_rate and (rate := capture.get(cv2.CAP_PROP_FPS)) > 0:
                self._period = 1.0 / rate
            while True:
                there, picture = capture.read()
                if not there:
                    return
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
            picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
            if picture is None:
                raise DeviceLost(f"{self.name}: {path} is no picture that OpenCV reads")
            yield cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
