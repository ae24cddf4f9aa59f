"""The two implementations behind one face, for the conformance suite."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path

import zenoh
from bus_tables import CALLS, TOPICS

from vantage.bus import Bus, Event, InProcessNetwork, VirtualClock
from vantage.bus.zenoh_bus import ZenohBus

PATIENCE = 120.0
"""Seconds after which something that should have come counts as missing: a bound for failures only."""


class Network(ABC):
    """Sessions of one arena."""

    def __init__(self) -> None:
        self.sessions: list[Bus] = []

    def session(self, name: str) -> Bus:
        bus = self.open(name)
        self.sessions.append(bus)
        return bus

    @abstractmethod
    def open(self, name: str) -> Bus: ...

    @abstractmethod
    def collect(self, bus: Bus, done: Callable[[list[Event]], bool]) -> list[Event]:
        """Receive until `done(events)`; fails when that does not come."""

    def take(self, bus: Bus, count: int) -> list[Event]:
        return self.collect(bus, lambda events: len(events) >= count)

    @abstractmethod
    def rest(self, bus: Bus) -> list[Event]:
        """Receive what comes until it is quiet."""

    @abstractmethod
    def pass_time(self, seconds: float) -> None:
        """Let the calls' clock go on."""

    def wait_for_reader(self, bus: Bus, key: str) -> None:
        end = time.monotonic() + PATIENCE
        while not bus.has_reader(key):
            assert time.monotonic() < end, f"nobody came to read {key}"
            time.sleep(0.005)

    def close(self) -> None:
        for bus in self.sessions:
            bus.close()


class InProcess(Network):
    def __init__(self) -> None:
        super().__init__()
        self.clock = VirtualClock()
        self.network = InProcessNetwork("test", self.clock, checked=True, topics=TOPICS, calls=CALLS)

    def open(self, name: str) -> Bus:
        return self.network.session(name)

    def collect(self, bus: Bus, done: Callable[[list[Event]], bool]) -> list[Event]:
        events: list[Event] = []
        while not done(events):
            event = bus.receive(1.0)
            assert event is not None, f"only {events}"
            events.append(event)
        return events

    def rest(self, bus: Bus) -> list[Event]:
        events = []
        while (event := bus.receive(0.0)) is not None:
            events.append(event)
        return events

    def pass_time(self, seconds: float) -> None:
        self.clock.advance(seconds)


class Participant:
    """A process that runs bus_participant.py, with a wall clock that is `set_by` s ahead of the machine's."""

    def __init__(self, folder: Path, name: str, role: str, *keys: str, set_by: float = 0.0) -> None:
        here = Path(__file__).parent
        command = [sys.executable, str(here / "bus_participant.py"), str(folder), name, role, *keys]
        self.process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=here.parent.parent,
            env={**os.environ, "WALL_CLOCK_SET_BY": str(set_by)},
        )
        self.lines: list[list[object]] = []

    def line(self) -> list[object]:
        """Return the next thing it says."""
        assert self.process.stdout is not None
        text = self.process.stdout.readline()
        assert text, f"the participant ended: {self.process.stderr.read() if self.process.stderr else ''}"
        self.lines.append(json.loads(text))
        return self.lines[-1]

    def wait_for(self, word: str) -> list[object]:
        while (line := self.line())[0] != word:
            pass
        return line

    def signal(self, number: signal.Signals) -> None:
        os.kill(self.process.pid, number)

    def kill(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()


class Zenoh(Network):
    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="v", dir="/tmp"))
        self.participants: list[Participant] = []
        self.strangers: list[zenoh.Session] = []

    def open(self, name: str) -> Bus:
        return ZenohBus(name, self.folder, "table", topics=TOPICS, calls=CALLS)

    def collect(self, bus: Bus, done: Callable[[list[Event]], bool]) -> list[Event]:
        events: list[Event] = []
        end = time.monotonic() + PATIENCE
        while not done(events):
            event = bus.receive(end - time.monotonic())
            assert event is not None, f"only {len(events)} came: {events[-20:]}"
            events.append(event)
        return events

    def rest(self, bus: Bus) -> list[Event]:
        # Longer than two heartbeats: what a heartbeat would still bring has come.
        events = []
        while (event := bus.receive(0.5)) is not None:
            events.append(event)
        return events

    def pass_time(self, seconds: float) -> None:
        """The real clock goes by itself, while the next receive waits."""

    def participant(self, name: str, role: str, *keys: str, set_by: float = 0.0) -> Participant:
        """Return a child process, once it is ready."""
        participant = Participant(self.folder, name, role, *keys, set_by=set_by)
        self.participants.append(participant)
        participant.wait_for("ready")
        return participant

    def stranger(self) -> zenoh.Session:
        """Return a bare Zenoh session within the folder."""
        from vantage.bus.zenoh_session import configuration

        session = zenoh.open(
            zenoh.Config.from_json5(
                json.dumps(configuration("stranger", self.folder, frozenset({"publisher", "second", "server"})))
            )
        )
        self.strangers.append(session)
        return session

    def wait_for_names(self, stranger: zenoh.Session, names: set[str]) -> None:
        """Wait until a bare session is connected to these participants, which announce themselves last."""
        end = time.monotonic() + PATIENCE
        found: set[str] = set()
        while not names <= found:
            assert time.monotonic() < end, f"only {found}"
            replies = stranger.liveliness().get("vantage-alive/table/*", timeout=1.0)
            found |= {str(reply.ok.key_expr).rpartition("/")[2] for reply in replies if reply.ok is not None}

    def close(self) -> None:
        super().close()
        for participant in self.participants:
            participant.kill()
        for session in self.strangers:
            session.close()
        shutil.rmtree(self.folder)
