"""The serial port as a device, over a real pseudo-terminal in real time; and the driver's whole way through it."""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue

import numpy as np
import pytest

from schemas import PRIMITIVES, Command, Episode, Layout, Motion, Primitive, Track
from services.robot.core import RobotCore
from services.robot.serial_port import SerialPort
from services.robot.settings import RobotSettings
from vantage.rehearsal.body import Body, BodySettings
from vantage.rehearsal.firmware import Firmware, FirmwareSettings
from vantage.rehearsal.pseudo_terminal import PseudoTerminal
from vantage.service import (
    SECOND,
    Arrived,
    Captured,
    DeviceLost,
    Publish,
    Received,
    Woken,
    Write,
    steady_clock,
)
from vantage.service.device import DeviceThread
from vantage.world.arena import STAY
from vantage.world.game import move_both
from vantage.world.layout import boxes_array
from vantage.world.start import draw_start

NOTHING = boxes_array(())


def read_until(port: SerialPort, enough: Callable[[bytes], bool]) -> bytes:
    data, deadline = b"", time.monotonic() + 5.0
    while not enough(data) and time.monotonic() < deadline:
        got = port.read()
        data += got[0] if got else b""
    return data


def test_bytes_pass_both_ways_unchanged(tmp_path: Path) -> None:
    far = PseudoTerminal(tmp_path / "hider")
    port = SerialPort("hider", str(tmp_path / "hider"), 115_200)
    port.open()
    everything = bytes(range(256))
    far.write(everything)
    assert read_until(port, lambda data: len(data) >= 256) == everything
    port.write(everything)
    received, deadline = b"", time.monotonic() + 5.0
    while len(received) < 256 and time.monotonic() < deadline:
        received += far.read()
    assert received == everything
    port.close()
    port.close()
    far.close()
    far.close()


def test_a_read_without_bytes_waits_a_moment_only(tmp_path: Path) -> None:
    far = PseudoTerminal(tmp_path / "hider")
    port = SerialPort("hider", str(tmp_path / "hider"), 115_200)
    port.open()
    began = time.monotonic()
    assert port.read() is None
    assert time.monotonic() - began < 0.5
    port.close()
    far.close()


def test_a_port_that_is_not_there_is_named(tmp_path: Path) -> None:
    port = SerialPort("hider", str(tmp_path / "nothing"), 115_200)
    with pytest.raises(DeviceLost, match=r"robot hider: cannot open .*nothing \(No such file or directory\).*plugged in"):
        port.open()
    port.write(b"into the void")
    with pytest.raises(DeviceLost):
        port.read()


def test_unplugged_and_plugged_in_again(tmp_path: Path) -> None:
    far = PseudoTerminal(tmp_path / "hider")
    port = SerialPort("hider", str(tmp_path / "hider"), 115_200)
    port.open()
    far.close()
    with pytest.raises(DeviceLost, match="unplugged"):
        read_until(port, lambda _: False)
    port.write(b"gone")
    port.close()
    again = PseudoTerminal(tmp_path / "hider")
    port.open()
    again.write(b"hello")
    assert read_until(port, lambda data: len(data) >= 5) == b"hello"
    port.close()
    again.close()


def test_writing_to_a_robot_that_does_not_read_never_waits(tmp_path: Path) -> None:
    far = PseudoTerminal(tmp_path / "hider")
    port = SerialPort("hider", str(tmp_path / "hider"), 115_200)
    port.open()
    began = time.monotonic()
    for _ in range(2000):
        port.write(b"x" * 60)
    assert time.monotonic() - began < 2.0
    port.close()
    far.close()


def test_a_pseudo_terminal_replaces_an_old_link_and_takes_only_its_own_away(tmp_path: Path) -> None:
    first = PseudoTerminal(tmp_path / "hider")
    second = PseudoTerminal(tmp_path / "hider")
    assert os.readlink(tmp_path / "hider") == second.device
    first.close()
    assert os.readlink(tmp_path / "hider") == second.device
    second.close()
    assert not os.path.lexists(tmp_path / "hider")


class RealTable:
    """In real time: an emulated hider behind a pseudo-terminal, a camera of 30 frames a second, 40 ms late, and the driver."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.terminal: PseudoTerminal | None = PseudoTerminal(path)
        self.body = Body(BodySettings(), 0.4, 0.4, 0.3)
        self.firmware = Firmware(self.body, FirmwareSettings(), seed=3)
        self.core = RobotCore(RobotSettings(hider_port=str(path)))
        self.port = SerialPort("hider", str(path), 115_200)
        self.motions: list[Motion] = []
        self._queue: SimpleQueue[object] = SimpleQueue()
        self._thread = DeviceThread(self.port, self._queue.put, steady_clock)
        self._thread.start()
        self._frame = 0
        self._tracks: deque[Track] = deque()

    def close(self) -> None:
        self._thread.stop()
        if self.terminal is not None:
            self.terminal.close()

    def run(self, until: Callable[[], bool], limit: float) -> bool:
        end = time.monotonic() + limit
        while time.monotonic() < end:
            if until():
                return True
            self._turn()
            time.sleep(0.001)
        return until()

    def give(self, received: Received) -> None:
        for send in self.core.step(received, steady_clock()):
            if isinstance(send, Write):
                self.port.write(send.data)
            elif isinstance(send, Publish) and isinstance(send.message, Motion):
                self.motions.append(send.message)

    def _turn(self) -> None:
        now = steady_clock()
        if self.terminal is not None:
            self.firmware.feed(self.terminal.read(), now)
        data = self.firmware.advance(now, NOTHING, None)
        if self.terminal is not None and data:
            self.terminal.write(data)
        if now * 30 // SECOND != self._frame:
            self._frame = now * 30 // SECOND
            x, y, heading = float(self.body.x), float(self.body.y), math.remainder(self.body.heading, math.tau)
            self._tracks.append(Track(stamp=now, x=x, y=y, heading=heading))
        while self._tracks and self._tracks[0].stamp < now - 40_000_000:
            track = self._tracks.popleft()
            self.give(Arrived("hider/track", track))
            self.give(Arrived("seeker/track", Track(stamp=track.stamp, x=0.9, y=0.9, heading=0.0)))
        while not self._queue.empty():
            event = self._queue.get()
            assert isinstance(event, Captured)
            self.give(event)
        wake = self.core.wake_at()
        if wake is not None and wake <= now:
            self.give(Woken())


def test_primitives_over_a_real_pseudo_terminal_and_a_cable_pulled_in_mid_game(tmp_path: Path) -> None:
    table = RealTable(tmp_path / "hider")
    try:
        x, y, heading = draw_start(NOTHING, 1.2, 1.2, 5, 0.25, 0.45)[0]
        table.body.x, table.body.y, table.body.heading = x + 0.001, y, 10.0 * math.radians(heading)
        table.run(lambda: False, 0.3)
        table.give(Arrived("episode", Episode(stamp=steady_clock(), episode=1, seed=5, phase="setup")))
        table.give(Arrived("layout", Layout(stamp=steady_clock(), episode=1)))
        assert table.run(lambda: len(table.motions) == 1, 10.0), table.core.trouble
        pose = np.array([[x, y, heading], [0.9, 0.9, 0.0]])
        primitives: tuple[Primitive, ...] = ("forward", "left", "backward", "right", "stay")
        for step, primitive in enumerate(primitives):
            step_both(table, step, primitive)
            assert table.run(lambda wanted=step + 2: len(table.motions) == wanted, 4.0), table.core.trouble  # type: ignore[misc]
            move_both(NOTHING, 1.2, 1.2, pose, np.array([PRIMITIVES.index(primitive), STAY]), pose, np.empty(2, np.bool_))
            assert (table.motions[-1].result, table.motions[-1].step) == ("completed", step + 1)
            assert math.dist((table.body.x, table.body.y), pose[0, :2]) <= 0.002
            assert abs(math.remainder(table.body.heading - math.radians(10.0 * pose[0, 2]), math.tau)) <= math.radians(2.0)

        assert table.terminal is not None
        table.terminal.close()
        table.terminal = None
        step_both(table, 5, "forward")
        assert table.run(lambda: len(table.motions) == 7, 3.0)
        assert table.motions[-1].result == "stopped"
        assert table.run(lambda: str(table.path) in table.core.trouble, 3.0)
        table.terminal = PseudoTerminal(table.path)
        assert table.run(lambda: table.core.trouble == "", 5.0), table.core.trouble
        step_both(table, 6, "forward")
        assert table.run(lambda: len(table.motions) == 8, 4.0)
        assert table.motions[-1].result == "completed"
    finally:
        table.close()


def step_both(table: RealTable, step: int, primitive: Primitive) -> None:
    table.give(Arrived("hider/command", Command(stamp=1, episode=1, step=step, primitive=primitive)))
    table.give(Arrived("seeker/command", Command(stamp=1, episode=1, step=step, primitive="stay")))
