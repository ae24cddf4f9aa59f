"""Which device a source's name means: `bus`, a camera, a file or a folder."""

from __future__ import annotations

from pathlib import Path

from services.tracker.devices import DrivenCamera, OverheadSettings, PictureFolder, VideoFile
from services.tracker.realsense import RealSense
from services.tracker.recordings import FrameFolder, LoggedFrames
from vantage.service import Device
from vantage.tracking.video_capture import RATE

BUS = "bus"
_LOG = ".mcap"


def overhead_device(name: str, source: str, settings: OverheadSettings) -> Device | None:
    """Return the device of an overhead source: None for `bus`, a camera by number or /dev path, a video file, a folder."""
    if source == BUS:
        return None
    if source.isdigit() or source.startswith("/dev/"):
        return DrivenCamera(name, source, settings)
    path = Path(source)
    if path.is_dir():
        return PictureFolder(name, path, RATE if settings.overhead_rate is None else settings.overhead_rate)
    return VideoFile(name, path, settings.overhead_rate)


def rgbd_device(name: str, robot: str, source: str, rate: float) -> Device | None:
    """Return the device of a robot's source: None for `bus`, `realsense[:SERIAL]`, a log (.mcap file or folder), a folder."""
    if source == BUS:
        return None
    kind, _, serial = source.partition(":")
    if kind == "realsense":
        return RealSense(name, serial)
    path = Path(source)
    if path.suffix == _LOG or (path.is_dir() and any(path.glob(f"*{_LOG}"))):
        return LoggedFrames(name, path, rate, robot)
    return FrameFolder(name, path, rate)
