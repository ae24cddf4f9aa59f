"""The planner as a process: `python -m services.planner --help`."""

import sys
from dataclasses import dataclass, field

import tyro

from services.planner.core import PlannerCore, PlannerSettings
from vantage.service import BusSettings, run


@dataclass(frozen=True)
class Settings:
    """The planner: A* to 121 goals, value map, goal, and the hider's low-level controller."""

    bus: tyro.conf.OmitArgPrefixes[BusSettings] = field(default_factory=BusSettings)
    plan: tyro.conf.OmitArgPrefixes[PlannerSettings] = field(default_factory=PlannerSettings)


def main(settings: Settings) -> int:
    return run(lambda: PlannerCore(settings.plan), "planner", settings.bus)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
