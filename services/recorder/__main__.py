"""The recorder as a process: `python -m services.recorder --help`."""

import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import tyro

from services.recorder.core import RecorderCore, RecorderSettings
from vantage.service import BusSettings, run


@dataclass(frozen=True)
class Settings:
    """The recorder: everything on the bus into MCAP logs."""

    bus: tyro.conf.OmitArgPrefixes[BusSettings] = field(default_factory=BusSettings)
    recorder: tyro.conf.OmitArgPrefixes[RecorderSettings] = field(default_factory=RecorderSettings)


def deployment_text(folder: Path) -> str:
    """The process table in force, which `vantage up` leaves in the deployment's folder."""
    path = folder / "deployment.conf"
    return path.read_text() if path.is_file() else ""


def main(settings: Settings) -> int:
    bus = settings.bus
    return run(lambda: RecorderCore(settings.recorder, bus.arena, deployment_text(bus.folder), time.time_ns()), "recorder", bus)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
