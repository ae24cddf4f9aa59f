"""The simulator as a process: `python -m services.simulator --help`."""

import sys
from dataclasses import dataclass, field

import tyro

from services.simulator.core import SimulatorCore, SimulatorSettings
from vantage.service import BusSettings, run


@dataclass(frozen=True)
class Settings:
    """The simulator: bodies and cameras of both robots.

    Example: python -m services.simulator --folder . --width 160 --height 120
    """

    bus: tyro.conf.OmitArgPrefixes[BusSettings] = field(default_factory=BusSettings)
    world: tyro.conf.OmitArgPrefixes[SimulatorSettings] = field(default_factory=SimulatorSettings)


def main(settings: Settings) -> int:
    return run(lambda: SimulatorCore(settings.world), "simulator", settings.bus)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
