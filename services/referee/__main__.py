"""The referee as a process: `python -m services.referee --help`."""

import sys
from dataclasses import dataclass, field

import tyro

from services.referee.core import RefereeCore, RefereeSettings
from vantage.service import BusSettings, run


@dataclass(frozen=True)
class Settings:
    """The referee: sets games up, keeps the step clock, judges the catch."""

    bus: tyro.conf.OmitArgPrefixes[BusSettings] = field(default_factory=BusSettings)
    play: tyro.conf.OmitArgPrefixes[RefereeSettings] = field(default_factory=RefereeSettings)


def main(settings: Settings) -> int:
    return run(lambda: RefereeCore(settings.play), "referee", settings.bus)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
