"""The calibration files: read together, refused in one line, and read again when somebody calibrates while the tracker runs."""

from __future__ import annotations

import datetime
import time
from dataclasses import dataclass
from pathlib import Path

from schemas import ROBOTS
from services.tracker.core import CALIBRATION, Calibrated
from vantage.service import CannotStart, DeviceLost, steady_clock
from vantage.tracking.calibration import load_calibration
from vantage.tracking.errors import UnusableCalibration, UnusableTable
from vantage.tracking.rgbd import UnusableRgbdCalibration, load_rgbd
from vantage.tracking.table import load_table

UNUSABLE = (UnusableTable, UnusableCalibration, UnusableRgbdCalibration)
POLL = 0.2
"""Seconds between two looks at the files."""


@dataclass(frozen=True)
class CalibrationSettings:
    """Where the set-up wrote what it found."""

    table: Path = Path("table.json")
    """Which tag is where (`vantage table print`)."""
    calibration: Path = Path("overhead.json")
    """Lens and place of the overhead camera (`vantage table calibrate`)."""
    hider_calibration: Path = Path("hider.json")
    """The hider's RGB-D camera."""
    seeker_calibration: Path = Path("seeker.json")
    """The seeker's RGB-D camera."""
    oldest_days: int = 90
    """Days after which a calibration of the overhead camera is refused."""
    patience: float = 0.0
    """Seconds to wait at the start for files that are not there yet."""


class CalibrationFiles:
    """The files as a device: gives a new `Calibrated` when they have changed and stand still again. See `vantage.service.Device`.

    Args:
        width, height: of the overhead camera's pictures, px.
    """

    name = CALIBRATION
    newest_only = False

    def __init__(self, settings: CalibrationSettings, width: int, height: int) -> None:
        self._settings, self._size = settings, (width, height)
        self._paths = (settings.table, settings.calibration, settings.hider_calibration, settings.seeker_calibration)
        self._read_at: tuple[int, ...] = ()
        self._changed_at: tuple[int, ...] = ()

    def load(self) -> Calibrated:
        """Read all files.

        Raises:
            UnusableTable, UnusableCalibration, UnusableRgbdCalibration: one is missing, stale or wrong.
        """
        self._read_at = self._changed_at = self._times()
        settings = self._settings
        robots = (settings.hider_calibration, settings.seeker_calibration)
        return Calibrated(
            load_table(settings.table),
            load_calibration(settings.calibration, *self._size, datetime.date.today(), settings.oldest_days),
            {robot: load_rgbd(path) for robot, path in zip(ROBOTS, robots, strict=True)},
        )

    def load_at_start(self) -> Calibrated:
        """Wait for the files as long as the settings say, and read them.

        Raises:
            CannotStart: one is missing, stale or wrong.
        """
        deadline = time.monotonic() + self._settings.patience
        while not all(path.exists() for path in self._paths) and time.monotonic() < deadline:
            time.sleep(POLL)
        try:
            return self.load()
        except UNUSABLE as error:
            raise CannotStart(str(error)) from error

    def open(self) -> None:
        """Nothing to open."""

    def read(self) -> tuple[Calibrated, int] | None:
        time.sleep(POLL)
        times = self._times()
        settled = times == self._changed_at
        self._changed_at = times
        if times == self._read_at or not settled:
            return None
        try:
            return self.load(), steady_clock()
        except UNUSABLE as error:
            raise DeviceLost(f"the former calibration stays in force: {error}") from error

    def write(self, data: bytes) -> None:
        raise NotImplementedError("the tracker writes no calibration")

    def close(self) -> None:
        """Nothing to close."""

    def _times(self) -> tuple[int, ...]:
        return tuple(path.stat().st_mtime_ns if path.exists() else 0 for path in self._paths)
