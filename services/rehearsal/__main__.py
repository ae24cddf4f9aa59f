"""The rehearsal as a process: `python -m services.rehearsal --help`."""

import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

import tyro

from services.rehearsal.cameras import Cameras
from services.rehearsal.core import LINES, CameraSettings, RehearsalCore
from services.rehearsal.devices import Faults, Line, Truth
from services.rehearsal.preparation import TableSettings, calibrate_and_write, prepare_table
from services.rehearsal.world import World, WorldSettings
from vantage.service import BusSettings, CannotStart, Device, run
from vantage.tracking.errors import TrackingError


@dataclass(frozen=True)
class Settings:
    """The rehearsal: stands for a physical table, with robots that slip and lag and cameras that err.

    It writes table.json, overhead.json, hider.json and seeker.json into the folder: what a calibration of its cameras found.

    Example: python -m services.rehearsal --folder . --layout random --layout-seed 7
    """

    bus: tyro.conf.OmitArgPrefixes[BusSettings] = field(default_factory=BusSettings)
    table: tyro.conf.OmitArgPrefixes[TableSettings] = field(default_factory=TableSettings)
    cameras: tyro.conf.OmitArgPrefixes[CameraSettings] = field(default_factory=CameraSettings)
    world: WorldSettings = field(default_factory=WorldSettings)
    faults: Path = Path("unplugged")
    """File that names what is unplugged, one a line: `overhead camera`, `hider camera`, `seeker line`, ..."""
    truth_file: Path | None = None
    """CSV file for where the robots truly are, for studies of accuracy; nobody else is told."""


def make_table(settings: Settings) -> tuple[RehearsalCore, Cameras]:
    """Return the table and what draws its pictures.

    Raises:
        CannotStart, ImpossibleLayout: nobody could play on it.
    """
    try:
        prepared = prepare_table(settings.table)
        calibrate_and_write(prepared, settings.bus.folder, settings.cameras.seed)
    except TrackingError as error:
        raise CannotStart(str(error)) from error
    world = World(prepared.obstacles, prepared.starts, settings.cameras.seed, settings.world)
    cameras = replace(settings.cameras, truth=settings.truth_file is not None)
    drawn = Cameras(prepared.obstacles, prepared.scene, prepared.cameras, cameras.seed)
    return RehearsalCore(world, cameras), drawn


def main(settings: Settings) -> int:
    folder = settings.bus.folder
    faults = Faults(folder / settings.faults)
    devices: list[Device] = [faults, *(Line(name, folder / f"{robot}.tty", faults) for name, robot in LINES.items())]
    if settings.truth_file is not None:
        devices.append(Truth(settings.truth_file))

    def make_core() -> RehearsalCore:
        core, cameras = make_table(settings)
        devices.append(cameras)
        return core

    return run(make_core, "rehearsal", settings.bus, devices)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
