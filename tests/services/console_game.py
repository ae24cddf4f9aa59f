"""A table in one thread with a console and pages on it: the real cores on the in-process bus, frames as the pages get them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

from schemas import Health, Message
from services.console.core import ConsoleCore
from services.console.events import PAGE, PageEvent
from services.console.requests import AnyRequest, Start
from services.console.welcome import welcome
from services.referee.core import RefereeCore, RefereeSettings
from services.seeker.core import SeekerCore
from services.simulator.core import SimulatorCore
from vantage.bus import InProcessNetwork, Sample, VirtualClock
from vantage.service import SECOND, Captured, Core, Runtime, run_in_process

Frame = tuple[dict[str, Any], bytes]


def parse(data: bytes) -> Frame:
    """Header and payload of a frame, as the page reads it."""
    length = int.from_bytes(data[:4], "little")
    return json.loads(data[4 : 4 + length]), data[4 + length :]


class Pages:
    """The device `page`, with pages that see everything at once."""

    name = PAGE
    newest_only = False

    def __init__(self) -> None:
        self.seen: dict[int, list[Frame]] = {}

    def open(self) -> None: ...

    def read(self) -> None:
        return None

    def close(self) -> None: ...

    def write(self, data: bytes) -> None:
        client = int.from_bytes(data[:4], "little")
        for number in [client] if client else list(self.seen):
            self.seen[number].append(parse(data[4:]))


class Table:
    """Referee, simulator, seeker and whoever else is given, a console, and an observer of the bus."""

    def __init__(self, others: dict[str, Core] | None = None, start: int = 1_700_000_000_000_000_000) -> None:
        self.network = InProcessNetwork(clock=VirtualClock(start), checked=True)
        others = others or {}
        self._referee = RefereeSettings(required=("simulator", "seeker", *others))
        cores: dict[str, Core] = {
            "referee": RefereeCore(self._referee),
            "simulator": SimulatorCore(),
            "seeker": SeekerCore(),
            **others,
        }
        self.said: list[tuple[str, Message]] = []
        """Everything on the bus, in order."""
        self.observer = self.network.session("recorder")
        self.observer.subscribe("**", raw=True)
        self.runtimes = [Runtime(core, self.network.session(name), self.network.clock) for name, core in cores.items()]
        self.pages = Pages()
        self.silent = False
        """Whether the console says nothing of its health."""
        self._next_health = 0
        self.open_console()

    def open_console(self) -> None:
        self.core = ConsoleCore(welcome("table", "simulation"))
        self.bus = self.network.session("console")
        self.console = Runtime(self.core, self.bus, self.network.clock, devices=[self.pages])
        self.runtimes.append(self.console)

    def restart_console(self) -> None:
        """The console dies, and its pages with it; another one comes."""
        self.runtimes.remove(self.console)
        self.bus.close()
        self.pages.seen.clear()
        self.open_console()

    def restart_referee(self) -> None:
        """The referee dies; another one comes."""
        old = next(runtime for runtime in self.runtimes if isinstance(runtime.core, RefereeCore))
        self.runtimes.remove(old)
        old.bus.close()
        self.runtimes.append(Runtime(RefereeCore(self._referee), self.network.session("referee"), self.network.clock))

    @property
    def now(self) -> int:
        return self.network.clock()

    def come(self, client: int = 1) -> int:
        self.pages.seen[client] = []
        self.bus.post(Captured(PAGE, PageEvent(client), self.now))
        return client

    def go(self, client: int = 1) -> None:
        self.pages.seen.pop(client, None)
        self.bus.post(Captured(PAGE, PageEvent(client, here=False), self.now))

    def ask(self, request: AnyRequest, client: int = 1) -> None:
        self.bus.post(Captured(PAGE, PageEvent(client, request), self.now))

    def run(self, until: Callable[[], bool], seconds: float = 300.0) -> None:
        """Let everybody work until `until()`; virtual seconds."""
        end = self.now + int(seconds * 1e9)

        def over() -> bool:
            if self.now >= self._next_health and not self.silent:
                # In one thread nobody reports health by himself; the referee wants to hear that a human could drive.
                self._next_health = self.now + SECOND
                self.bus.publish("health/console", self.console.health_report("ok"))
            self._observe()
            assert self.now < end, "what was waited for has not come"
            return until()

        run_in_process(self.network, self.runtimes, over)

    def run_for(self, seconds: float) -> None:
        end = self.now + int(seconds * 1e9)
        self.run(lambda: self.now >= end, seconds + 10)

    def settle(self) -> None:
        """Let everybody handle what is there, at this very time."""
        while sum(runtime.drain() for runtime in self.runtimes):
            self._observe()
        self._observe()

    def _observe(self) -> None:
        while (event := self.observer.receive(0.0)) is not None:
            if isinstance(event, Sample):
                self.said.append((event.key, event.decode()))

    def of(self, key: str) -> list[Any]:
        """All messages of a key."""
        return [message for at, message in self.said if at == key]

    def frames(self, key: str, client: int = 1) -> list[Frame]:
        return [(header, payload) for header, payload in self.pages.seen[client] if header["key"] == key]

    def header(self, key: str, client: int = 1) -> dict[str, Any]:
        return self.frames(key, client)[-1][0]

    def notices(self, client: int = 1) -> list[str]:
        return [header["text"] for header, _ in self.frames("notice", client)]

    def say(self, service: str, messages: Sequence[tuple[str, Message]]) -> None:
        """Publish as another participant, and let the console take it in."""
        if service not in self.network.sessions:
            self.network.session(service)
        for key, message in messages:
            self.network.sessions[service].publish(key, message)
        self.settle()


def health(service: str, now: int, state: str = "ok", reason: str = "") -> Health:
    return Health(stamp=now, service=service, state=state, process=1, uptime=5.0, reason=reason)  # type: ignore[arg-type]


STEPS = 12


def play(table: Table, steps: int = STEPS, **more: Any) -> None:
    """A page asks for games of the planner; the first is played to its end."""
    table.ask(Start(steps=steps, seed=5, **more))
    before = len(table.of("episode"))
    table.run(lambda: any(message.phase in ("ended", "aborted") for message in table.of("episode")[before:]))
