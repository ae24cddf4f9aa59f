"""The seeker as a process: `python -m services.seeker --help`."""

import sys
from dataclasses import dataclass, field

import tyro

from services.seeker.core import SeekerCore, SeekerSettings
from vantage.service import BusSettings, run


@dataclass(frozen=True)
class Settings:
    """The seeker: the heuristic expert that drives the opponent."""

    bus: tyro.conf.OmitArgPrefixes[BusSettings] = field(default_factory=BusSettings)
    seeker: tyro.conf.OmitArgPrefixes[SeekerSettings] = field(default_factory=SeekerSettings)


def main(settings: Settings) -> int:
    return run(lambda: SeekerCore(settings.seeker), "seeker", settings.bus)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
