"""The driver as a process: `python -m services.robot --help`."""

import sys
from dataclasses import dataclass, field

import tyro

from schemas import ROBOTS
from services.robot.core import RobotCore
from services.robot.serial_port import SerialPort
from services.robot.settings import NO_PORT, RobotSettings
from vantage.service import BusSettings, run


@dataclass(frozen=True)
class Settings:
    """The driver: carries commands out with the wheels of real robots.

    Example: python -m services.robot --folder . --hider-port /dev/ttyUSB0 --seeker-port /dev/ttyUSB1
    """

    bus: tyro.conf.OmitArgPrefixes[BusSettings] = field(default_factory=BusSettings)
    robot: tyro.conf.OmitArgPrefixes[RobotSettings] = field(default_factory=RobotSettings)


def main(settings: Settings) -> int:
    ports = [
        SerialPort(robot, settings.robot.port_of(robot), settings.robot.baud)
        for robot in ROBOTS
        if settings.robot.port_of(robot) != NO_PORT
    ]
    return run(lambda: RobotCore(settings.robot), "robot", settings.bus, devices=ports)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
