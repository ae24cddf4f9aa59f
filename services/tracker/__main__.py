"""The tracker as a process: `python -m services.tracker --help`."""

import sys
from dataclasses import dataclass, field

import tyro

from services.tracker.calibrated import CalibrationFiles, CalibrationSettings
from services.tracker.core import OVERHEAD, TrackerCore, TrackerSettings
from services.tracker.devices import OverheadSettings
from services.tracker.sources import overhead_device, rgbd_device
from vantage.service import BusSettings, run


@dataclass(frozen=True)
class Settings:
    """The tracker: the cameras of a real table, to layout, tracks, and the poses and pictures of each step.

    Examples:
        python -m services.tracker --folder . --overhead /dev/video0 --hider-camera realsense:0123 --seeker-camera realsense:4567
        python -m services.tracker --folder . --overhead table.mp4      (a recorded video; folders of pictures, too)
    """

    bus: tyro.conf.OmitArgPrefixes[BusSettings] = field(default_factory=BusSettings)
    pictures: tyro.conf.OmitArgPrefixes[TrackerSettings] = field(default_factory=TrackerSettings)
    files: tyro.conf.OmitArgPrefixes[CalibrationSettings] = field(default_factory=CalibrationSettings)
    driven: tyro.conf.OmitArgPrefixes[OverheadSettings] = field(default_factory=OverheadSettings)
    overhead: str = "bus"
    """The overhead camera: `bus`, a number or /dev path, a video file, a folder of pictures."""
    hider_camera: str = "bus"
    """The hider's camera: `bus`, `realsense` or `realsense:SERIAL`, a log (its steps' pictures), a folder of recorded frames."""
    seeker_camera: str = "bus"
    """The seeker's camera, likewise."""
    recorded_rate: float = 5.0
    """Frames a second of recorded RGB-D streams; 0 = as fast as they are read."""


def main(settings: Settings) -> int:
    files = CalibrationFiles(settings.files, settings.driven.overhead_width, settings.driven.overhead_height)
    cameras = (
        overhead_device(OVERHEAD, settings.overhead, settings.driven),
        rgbd_device("hider camera", "hider", settings.hider_camera, settings.recorded_rate),
        rgbd_device("seeker camera", "seeker", settings.seeker_camera, settings.recorded_rate),
    )
    devices = [files, *(camera for camera in cameras if camera is not None)]
    return run(lambda: TrackerCore(files.load_at_start(), settings.pictures), "tracker", settings.bus, devices)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
