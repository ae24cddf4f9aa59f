"""The console as a process: `python -m services.console --help`."""

import sys
import threading
from dataclasses import dataclass, field

import tyro

from services.console.core import ConsoleCore
from services.console.human import warm_up
from services.console.server import PageServer, ServerSettings
from services.console.welcome import deployment_name, welcome
from vantage.service import BusSettings, run


@dataclass(frozen=True)
class Settings:
    """The console: a page in the browser that shows the game, and where a human plays the hider.

    Examples:
        python -m services.console --folder .
        python -m services.console --folder . --port 0                   any free port; see `console.address` in the folder
        python -m services.console --folder . --host 192.168.1.20        for others in the lab
    """

    bus: tyro.conf.OmitArgPrefixes[BusSettings] = field(default_factory=BusSettings)
    page: tyro.conf.OmitArgPrefixes[ServerSettings] = field(default_factory=ServerSettings)


def main(settings: Settings) -> int:
    about = welcome(settings.bus.arena, deployment_name(settings.bus.folder))
    threading.Thread(target=warm_up, name="warm-up", daemon=True).start()
    server = PageServer(settings.page, settings.bus.folder)
    return run(lambda: ConsoleCore(about), "console", settings.bus, [server])


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Settings)))
