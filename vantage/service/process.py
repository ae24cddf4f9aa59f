"""One service as a process on Zenoh."""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from vantage.errors import UserError, explain
from vantage.service.core import Core
from vantage.service.device import Device
from vantage.service.runtime import Runtime
from vantage.stopping import signal_on_parent_death

logger = logging.getLogger("vantage")


@dataclass(frozen=True)
class BusSettings:
    """Where the bus is."""

    folder: Path = Path()
    """Private folder of the deployment, which holds the sockets."""
    arena: str = "table"
    """Name of the arena: all keys stand below vantage/ARENA/."""


@contextmanager
def _stop_on_signal(runtime: Runtime) -> Iterator[None]:
    def handle(_number: int, _frame: FrameType | None) -> None:
        runtime.stop()

    previous = {number: signal.signal(number, handle) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _follow_supervisor(name: str) -> bool:
    """Make this process end with the supervisord that started it, if one did: two services of a name must not drive one robot.

    Returns whether supervisord has ended already.
    """
    if os.environ.get("SUPERVISOR_PROCESS_NAME") != name:
        return False
    signal_on_parent_death(signal.SIGTERM)
    try:
        return b"supervisor" not in Path(f"/proc/{os.getppid()}/cmdline").read_bytes()
    except OSError:
        return sys.platform == "linux"


def run(make_core: Callable[[], Core], name: str, settings: BusSettings, devices: Sequence[Device] = ()) -> int:
    """Run one service as a process on Zenoh until SIGTERM. Returns the exit code.

    Started by supervisord, it also ends when that does. What is wrong at the start (missing weights, a taken name, an impossible
    layout) is printed as one line.
    """
    from vantage.bus.zenoh_bus import ZenohBus  # only a process on a real bus pays for loading Zenoh

    if _follow_supervisor(name):
        print(f"{name} cannot start: its supervisord has ended", file=sys.stderr)
        return 1
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr)
    with ExitStack() as closing:
        try:
            core = make_core()
            if hasattr(core, "close"):
                closing.callback(core.close)
            bus = closing.enter_context(ZenohBus(name, settings.folder, settings.arena))
        except (UserError, ValueError, OSError) as error:
            print(f"{name} cannot start: {explain(error) or error}", file=sys.stderr)
            return 1
        runtime = Runtime(core, bus, devices=devices)
        with _stop_on_signal(runtime):
            logger.info("%s started", name)
            runtime.run()
    logger.info("%s stopped", name)
    return 0
