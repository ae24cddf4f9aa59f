"""How long from the capture of an overhead frame to the pose that another service has in hand.

The real tracker core, runtime and Zenoh bus; rendered 1280 x 720 frames at a camera's rate. Once the tracker opens the camera
itself (a device, as on a real table), once the frames come over the bus (as in rehearsal); the ratio of both says what the detour
costs. The reader is a second session in a thread of its own. `python benchmarks/tracker_latency.py --help` shows the settings.
"""

from __future__ import annotations

import statistics
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import tyro
from overhead_tracker import Settings as Frames
from overhead_tracker import motion, scene_of

from schemas import ROBOTS, ColorImage, Intrinsics, Track
from services.tracker.core import OVERHEAD, Calibrated, TrackerCore
from vantage.bus import Sample
from vantage.bus.zenoh_bus import ZenohBus
from vantage.service import Runtime, steady_clock
from vantage.tracking.rgbd import default_rgbd

Picture = npt.NDArray[np.uint8]


@dataclass
class Settings:
    """What is measured."""

    seconds: float = 15.0
    """of each side"""
    rate: float = 30.0
    """frames a second"""
    kept: int = 90
    """rendered frames, shown again and again, there and back"""
    seed: int = 1


class Camera:
    """Gives kept frames at a rate, stamped when it gives them. See `vantage.service.Device`."""

    name = OVERHEAD
    newest_only = True

    def __init__(self, frames: list[Picture], rate: float) -> None:
        self._frames, self._period, self._number, self._next = [*frames, *frames[::-1]], 1.0 / rate, 0, 0.0

    def open(self) -> None:
        self._next = time.monotonic()

    def read(self) -> tuple[Any, int] | None:
        self._next += self._period
        time.sleep(max(0.0, self._next - time.monotonic()))
        self._number += 1
        return self._frames[self._number % len(self._frames)], steady_clock()

    def write(self, data: bytes) -> None: ...
    def close(self) -> None: ...


def latencies(settings: Settings, calibrated: Calibrated, frames: list[Picture], over_bus: bool) -> list[float]:
    """Return ms from the stamp of a frame to the hider's track in the reader's hand, of every frame after the first second."""
    found: list[float] = []
    with tempfile.TemporaryDirectory(prefix="vl-") as folder:
        place = Path(folder)
        place.chmod(0o700)
        with ZenohBus("tracker", place) as bus, ZenohBus("console", place) as reader, ZenohBus("rehearsal", place) as camera_bus:
            camera = Camera(frames, settings.rate)
            runtime = Runtime(TrackerCore(calibrated), bus, devices=() if over_bus else (camera,))
            reader.subscribe("hider/track")
            serving = threading.Thread(target=runtime.run, daemon=True)
            stop = threading.Event()

            def show() -> None:
                camera.open()
                lens = Intrinsics(fx=1.0, fy=1.0, cx=0.0, cy=0.0)
                while not stop.is_set():
                    picture, stamp = camera.read()  # type: ignore[misc]
                    size = {"width": picture.shape[1], "height": picture.shape[0], "intrinsics": lens}
                    camera_bus.publish("overhead/color", ColorImage(stamp=stamp, data=picture.tobytes(), **size))

            serving.start()
            showing = threading.Thread(target=show, daemon=True)
            if over_bus:
                showing.start()
            end = time.monotonic() + settings.seconds + 1.0
            begin = time.monotonic() + 1.0
            while time.monotonic() < end:
                event = reader.receive(0.2)
                if isinstance(event, Sample):
                    track = event.decode()
                    if isinstance(track, Track) and track.seen and time.monotonic() > begin:
                        found.append((steady_clock() - track.stamp) / 1e6)
            stop.set()
            if over_bus:
                showing.join()
            runtime.stop()
            serving.join()
    return found


def main(settings: Settings) -> None:
    made = Frames(frames=settings.kept, rate=settings.rate)
    scene, tracker, boxes = scene_of(made, settings.seed)
    takes = motion(made, settings.seed, boxes)
    frames = []
    for number in range(settings.kept):
        take = next(takes)
        frames.append(scene.render(take.robots, boxes, settings.seed, number, take.speeds))
    calibrated = Calibrated(tracker.table, tracker.calibration, {robot: default_rgbd() for robot in ROBOTS})
    medians = []
    for over_bus in (False, True):
        found = sorted(latencies(settings, calibrated, frames, over_bus))
        median = statistics.median(found)
        medians.append(median)
        name = "frames over the bus" if over_bus else "the tracker's own camera"
        expected = settings.seconds * settings.rate
        print(
            f"{name:<26} p50 {median:5.1f} ms  p95 {found[int(0.95 * len(found))]:5.1f} ms  {len(found)} of {expected:.0f} frames"
        )
    print(f"own camera / over the bus: {medians[0] / medians[1]:.2f}")


if __name__ == "__main__":
    main(tyro.cli(Settings))
