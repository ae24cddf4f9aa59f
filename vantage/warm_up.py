"""Compiles every kernel once, so that no service spends its first seconds on it: `python -m vantage.warm_up`.

numba keeps the machine code on disk (`vantage.compiled`), for the types a kernel was called with. So the kernels are called the
way the services call them: by playing short games in process, and by looking at a rehearsed table.
"""

from __future__ import annotations

import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from learning.collect import CollectSettings, play_block
from schemas import ROBOTS, STATE_IMAGE_SIZE, Episode, Motion
from vantage.networks.inputs import CHANNELS, render_inputs
from vantage.service import SECOND, Arrived, Captured, Woken, Write

HIDERS = ("goal-walk", "scripted", "random")
STEPS = 25
PERIOD = SECOND // 100


def look_at_a_table(folder: Path) -> None:
    """Calibrate the cameras of a rehearsed table and let the tracker look through them at one step."""
    # Only a machine with the extra `tracker` has what these import.
    from services.rehearsal.cameras import Cameras
    from services.rehearsal.core import CAMERAS, RehearsalCore
    from services.rehearsal.preparation import TableSettings, calibrate_and_write, prepare_table
    from services.rehearsal.world import World
    from services.tracker.calibrated import CalibrationFiles, CalibrationSettings
    from services.tracker.core import TrackerCore

    prepared = prepare_table(TableSettings())
    calibrate_and_write(prepared, folder, seed=1)
    table, overhead, hider, seeker = (folder / f"{name}.json" for name in ("table", "overhead", *ROBOTS))
    files = CalibrationFiles(CalibrationSettings(table, overhead, hider, seeker), 1280, 720)
    tracker = TrackerCore(files.load_at_start())
    rehearsal = RehearsalCore(World(prepared.obstacles, prepared.starts, 1))
    cameras = Cameras(prepared.obstacles, prepared.scene, prepared.cameras, seed=1)
    tracker.step(Arrived("episode", Episode(stamp=0, episode=1, seed=1, phase="setup")), 0)
    for robot in ROBOTS:
        tracker.step(Arrived(f"{robot}/motion", Motion(stamp=0, episode=1, primitive="stay", result="completed")), 0)
    for now in range(SECOND, SECOND + SECOND // 2, PERIOD):
        for send in rehearsal.step(Woken(), now):
            if isinstance(send, Write) and send.device == CAMERAS:
                frames = cameras.draw(send.data)
                rehearsal.step(Captured(CAMERAS, frames, now), now)
                for key, image in frames:
                    tracker.step(Arrived(key, image), now)


def main() -> None:
    """Play one short game with each kind of hider, look at a rehearsed table, and throw what was written away."""
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        for hider in HIDERS:
            settings = CollectSettings(games=1, hider=hider, views=True, steps=STEPS, catching=False)
            play_block(settings, range(1, 2), Path(folder) / f"{hider}.mcap")
        if all(find_spec(package) for package in ("cv2", "pupil_apriltags")):
            look_at_a_table(Path(folder))
    first = np.zeros(1, np.int64)
    view = np.zeros((1, STATE_IMAGE_SIZE, STATE_IMAGE_SIZE), np.uint8)
    inputs = np.empty((1, STATE_IMAGE_SIZE, STATE_IMAGE_SIZE, CHANNELS), np.uint8)
    render_inputs(view, first, np.zeros((1, 2), np.float32), first, first, first, inputs)  # what the predictor calls
    print(f"the kernels are compiled ({time.monotonic() - started:.1f} s)")


if __name__ == "__main__":
    main()
