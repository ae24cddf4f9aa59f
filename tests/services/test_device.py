"""Devices of a service: read by threads, opened again when they are gone, the newest frame of a camera, every line of a port."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest

from vantage.bus import InProcessNetwork, VirtualClock
from vantage.service import Captured, Declaration, DeviceLost, Received, Runtime, Send, Write, device
from vantage.service.device import DeviceThread

PATIENCE = 120.0
OPENED = Captured("camera", None, 0)


@dataclass
class Made:
    """A device that gives what is put on its queue; an exception there is raised by `read`."""

    newest_only: bool
    name: str = "camera"
    broken: int = 0
    given: queue.Queue[Any] = field(default_factory=queue.Queue)
    opened: int = 0
    closed: int = 0
    written: list[bytes] = field(default_factory=list)

    def open(self) -> None:
        self.opened += 1
        if self.opened <= self.broken:
            raise DeviceLost("camera: not there, plug it in")

    def read(self) -> tuple[Any, int] | None:
        try:
            value = self.given.get(timeout=0.05)
        except queue.Empty:
            return None
        if isinstance(value, Exception):
            raise value
        return value, 7

    def write(self, data: bytes) -> None:
        self.written.append(data)

    def close(self) -> None:
        self.closed += 1


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "RETRY", 0.01)


def until(condition: Any) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "it did not come to that"
        time.sleep(0.002)


def test_a_port_loses_no_line_and_keeps_their_order() -> None:
    made, events = Made(newest_only=False), queue.Queue[Any]()
    thread = DeviceThread(made, events.put, lambda: 0)
    for line in range(100):
        made.given.put(line)
    thread.start()
    got = [events.get(timeout=PATIENCE) for _ in range(101)]
    thread.stop()
    assert got == [OPENED, *(Captured("camera", line, 7) for line in range(100))]
    assert made.closed == 1


def test_a_camera_that_is_not_read_keeps_its_newest_frame_alone() -> None:
    made, events = Made(newest_only=True), queue.Queue[Any]()
    thread = DeviceThread(made, events.put, lambda: 0)
    thread.start()
    for frame in range(20):
        made.given.put(frame)
    until(made.given.empty)
    until(lambda: thread._newest is not None and thread._newest.value == 19)
    assert events.qsize() == 2 and events.get() == OPENED and events.get() is thread
    assert thread.take() == Captured("camera", 19, 7)
    assert thread.take() is None
    made.given.put(20)
    assert events.get(timeout=PATIENCE) is thread and thread.take() == Captured("camera", 20, 7)
    thread.stop()


def test_a_lost_device_is_told_of_and_opened_again() -> None:
    made, events = Made(newest_only=False, broken=2), queue.Queue[Any]()
    thread = DeviceThread(made, events.put, lambda: 0)
    thread.start()
    lost = Captured("camera", None, 0, "camera: not there, plug it in")
    made.given.put("a")
    assert [events.get(timeout=PATIENCE) for _ in range(4)] == [lost, lost, OPENED, Captured("camera", "a", 7)]
    made.given.put(OSError("Input/output error"))  # a library may raise anything
    made.given.put("b")
    again = [Captured("camera", None, 0, "Input/output error"), OPENED, Captured("camera", "b", 7)]
    assert [events.get(timeout=PATIENCE) for _ in range(3)] == again
    thread.stop()
    assert made.opened == 4 and made.closed == 4


def test_a_device_that_refuses_to_be_closed_is_opened_again() -> None:
    made, events = Made(newest_only=False), queue.Queue[Any]()

    def refuse() -> None:
        raise RuntimeError("stop() cannot be called before start()")

    made.close = refuse  # type: ignore[method-assign]
    thread = DeviceThread(made, events.put, lambda: 0)
    thread.start()
    made.given.put(DeviceLost("gone"))
    made.given.put("back")
    assert [events.get(timeout=PATIENCE).value for _ in range(4)] == [None, None, None, "back"]
    thread.stop()


@dataclass
class Echo:
    """A core that sends back what its port said."""

    declaration: Declaration
    received: list[Received] = field(default_factory=list)

    def step(self, received: Received, now: int) -> Sequence[Send]:
        self.received.append(received)
        return [Write("camera", received.value)] if isinstance(received, Captured) and received.value else ()

    def wake_at(self) -> int | None:
        return None


@pytest.mark.parametrize("newest_only", [True, False])
def test_a_core_hears_and_commands_its_devices_through_the_runtime(newest_only: bool) -> None:
    made = Made(newest_only)
    bus = InProcessNetwork(clock=VirtualClock()).session("tracker")
    core = Echo(Declaration("tracker"))
    runtime = Runtime(core, bus, health=False, devices=(made,))
    running = threading.Thread(target=runtime.run)
    running.start()
    made.given.put(b"ping")
    until(lambda: made.written == [b"ping"])
    runtime.stop()
    running.join(PATIENCE)
    assert not running.is_alive() and made.closed == 1
    assert core.received[1:] == [Captured("camera", b"ping", 7)]
    assert isinstance(core.received[0], Captured) and core.received[0].value is None and not core.received[0].error
