"""A game without end on a real bus, with the console as a process and an honest page open."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from learning.hiders.core import HiderCore
from learning.hiders.random_primitives import RandomPrimitives
from schemas import Episode, Health, Players, Rules
from services.referee.core import RefereeCore, RefereeSettings
from services.seeker.core import SeekerCore
from services.simulator.core import SimulatorCore
from tests.services.console_socket import (
    Socket,
    Target,
)
from vantage.bus import Sample
from vantage.bus.zenoh_bus import ZenohBus
from vantage.deployment import CONSOLE_ADDRESS
from vantage.service import Core, Runtime
from vantage.world.camera import Camera


class Gaps:
    """The longest time between two of a thing."""

    def __init__(self) -> None:
        self.count = 0
        self.longest = 0.0
        self._last: float | None = None

    def begin(self) -> None:
        """Count from now on."""
        self.count, self.longest, self._last = 0, 0.0, None

    def note(self) -> None:
        now = time.monotonic()
        if self._last is not None:
            self.longest = max(self.longest, now - self._last)
        self._last = now
        self.count += 1


class Arena:
    """A game without end on a real bus, the console as a process, an observer, and an honest page.

    Args:
        host: what the console is bound to.
    """

    def __init__(self, period: float = 0.1, host: str = "127.0.0.2", camera: Camera | None = None) -> None:
        self._closing = contextlib.ExitStack()
        self.folder = Path(self._closing.enter_context(tempfile.TemporaryDirectory(prefix="vh-")))
        self.folder.chmod(0o700)
        self.bus_ticks, self.page_ticks = Gaps(), Gaps()
        self.of_console: Counter[str] = Counter()
        self.episodes: set[tuple[int, str]] = set()
        self.reasons: list[str] = []
        self.lost: dict[str, int] = {}
        self.ways: list[float] = []  # s from `publish` to the observer's hand
        self._stop = threading.Event()
        rules = Rules(maximum_steps=100_000, catching=False, step_period=period)
        referee = RefereeSettings(
            autoplay=True, rules=rules, players=Players(hider="random"), required=("simulator", "seeker", "hider")
        )

        def drive(episode: Episode) -> RandomPrimitives:
            import numpy as np

            return RandomPrimitives(episode.rules.maximum_steps, np.random.default_rng(1))

        cores: dict[str, Core] = {
            "simulator": SimulatorCore(),
            "seeker": SeekerCore(),
            "hider": HiderCore(drive),
            "referee": RefereeCore(referee),
        }
        observer = self._closing.enter_context(ZenohBus("recorder", self.folder))
        observer.subscribe("**", raw=True)
        self._observing = threading.Thread(target=self._observe, args=(observer,), daemon=True)
        self._observing.start()
        self._closing.callback(self._end_observing)
        for name, core in cores.items():
            runtime = Runtime(core, self._closing.enter_context(ZenohBus(name, self.folder)))
            thread = threading.Thread(target=runtime.run, name=name, daemon=True)
            thread.start()
            self._closing.callback(thread.join, 5.0)
            self._closing.callback(runtime.stop)
        command = [sys.executable, "-m", "services.console", "--folder", str(self.folder), "--port", "0", "--host", host]
        self.log = self.folder / "console.log"
        self.console = subprocess.Popen(command, stderr=self.log.open("w"), cwd=Path(__file__).resolve().parents[2])
        self._closing.callback(self._end_console)
        address = self.folder / CONSOLE_ADDRESS
        self.wait(address.is_file, "the console gives no address")
        url, _, fragment = address.read_text().strip().partition("#")
        name, _, port = url.removeprefix("http://").rstrip("/").rpartition(":")
        self.target = Target(host if host != "0.0.0.0" else "127.0.0.1", int(port), fragment.removeprefix("token="))
        self.page = Socket(self.target)
        threading.Thread(target=self._watch, daemon=True).start()
        self.wait(lambda: self.page_ticks.count > 3, "no tick comes to the page")

    def wait(self, until: Callable[[], bool], complaint: str, seconds: float = 60.0) -> None:
        end = time.monotonic() + seconds
        while not until():
            if time.monotonic() > end or self.console.poll() is not None:
                raise RuntimeError(f"{complaint}: {self.log.read_text()[-2000:]}")
            time.sleep(0.02)

    def _observe(self, observer: ZenohBus) -> None:
        while not self._stop.is_set():
            event = observer.receive(0.1)
            if not isinstance(event, Sample):
                continue
            self.ways.append((time.time_ns() - event.published) / 1e9)
            if event.publisher == "console":
                self.of_console[event.key] += 1
            if event.key == "tick":
                self.bus_ticks.note()
            elif event.key == "episode" or event.key.startswith("health/"):
                said = event.decode()
                if isinstance(said, Episode):
                    self.episodes.add((said.episode, said.phase))
                elif isinstance(said, Health):
                    self.lost[said.service] = sum(each.lost for each in said.inputs)
                    if said.service == "console" and said.reason:
                        self.reasons.append(said.reason)

    def _watch(self) -> None:
        with contextlib.suppress(OSError):  # closed at the end
            for header in self.page.headers():
                if header["key"] == "tick":
                    self.page_ticks.note()

    def _end_observing(self) -> None:
        self._stop.set()
        self._observing.join(5.0)

    def _end_console(self) -> None:
        self.console.terminate()
        try:
            self.console.wait(5.0)
        except subprocess.TimeoutExpired:
            self.console.kill()
            self.console.wait()

    def __enter__(self) -> Arena:
        return self

    def __exit__(self, *_: object) -> None:
        for connection in self.target.held:
            connection.close()
        self.page.raw.close()
        self._closing.close()
