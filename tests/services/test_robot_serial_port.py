"""The serial port as a device, over a real pseudo-terminal; and the driver's whole way through it."""

from __future__ import annotations

import contextlib
import math
import os
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue

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
)
from vantage.service.device import DeviceThread
from vantage.world.arena import STAY
from vantage.world.game import move_both
from vantage.world.layout import boxes_array
from vantage.world.start import draw_start

NOTHING = boxes_array(())


PATIENCE = 120.0
"""Seconds that bound a failure only: a busy machine is slow, not wrong."""


def read_until(port: SerialPort, enough: Callable[[bytes], bool]) -> bytes:
    data, deadline = b"", time.monotonic() + PATIENCE
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
    received, deadline = b"", time.monotonic() + PATIENCE
    while len(received) < 256 and time.monotonic() < deadline:
        received += far.read()
    assert received == everything
    port.close()
    port.close()
    far.close()
    far.close()


def test_a_read_without_bytes_ends(tmp_path: Path) -> None:
    far = PseudoTerminal(tmp_path / "hider")
    port = SerialPort("hider", str(tmp_path / "hider"), 115_200)
    port.open()
    assert port.read() is None
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
    for _ in range(2000):  # many times what the kernel holds: who waits for room waits for ever
        port.write(b"x" * 60)
    port.close()
    far.close()


def test_a_pseudo_terminal_replaces_an_old_link_and_takes_only_its_own_away(tmp_path: Path) -> None:
    first = PseudoTerminal(tmp_path / "hider")
    second = PseudoTerminal(tmp_path / "hider")
    link = os.readlink(tmp_path / "hider")
    first.close()
    assert os.readlink(tmp_path / "hider") == link
    second.close()
    assert not os.path.lexists(tmp_path / "hider")


def test_the_link_of_a_rehearsal_that_was_killed_leads_to_nobody_elses_terminal(tmp_path: Path) -> None:
    """The kernel gives the freed number to the next pseudo-terminal: somebody's shell, or another table's robot."""
    killed = "import os, sys; from vantage.rehearsal.pseudo_terminal import PseudoTerminal; from pathlib import Path; "
    killed += "PseudoTerminal(Path(sys.argv[1])); os.kill(os.getpid(), 9)"
    subprocess.run([sys.executable, "-c", killed, str(tmp_path / "hider")], check=False)
    assert os.path.lexists(tmp_path / "hider")
    others = [os.openpty() for _ in range(8)]
    port = SerialPort("hider", str(tmp_path / "hider"), 115_200)
    try:
        with pytest.raises(DeviceLost, match="cannot open"):
            port.open()
    finally:
        for ends in others:
            for end in ends:
                os.close(end)


class RealTable:
    """An emulated hider behind a real pseudo-terminal, a camera of 30 frames a second, 40 ms late, and the driver.

    Time is the table's own and stands still while bytes are under way, so that it does not matter how busy the machine is.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.terminal: PseudoTerminal | None = PseudoTerminal(path)
        self.body = Body(BodySettings(), 0.4, 0.4, 0.3)
        self.firmware = Firmware(self.body, FirmwareSettings(), seed=3)
        self.core = RobotCore(RobotSettings(hider_port=str(path)))
        self.port = SerialPort("hider", str(path), 115_200)
        self.motions: list[Motion] = []
        self.now = 1_700_000_000 * SECOND
        self._queue: SimpleQueue[object] = SimpleQueue()
        self._thread = DeviceThread(self.port, self._queue.put, lambda: self.now)
        self._thread.start()
        self._open = False
        self._to_robot = self._to_driver = 0
        self._frame = 0
        self._tracks: deque[Track] = deque()
        self.run(lambda: self._open)

    def close(self) -> None:
        self._thread.stop()
        if self.terminal is not None:
            self.terminal.close()

    def unplug(self) -> None:
        assert self.terminal is not None
        self.terminal.close()
        self.terminal = None
        self._wait(lambda: not self._open)

    def plug_in(self) -> None:
        self.terminal = PseudoTerminal(self.path)
        self._to_robot = self._to_driver = 0
        self._wait(lambda: self._open)

    def run(self, until: Callable[[], bool], limit: float = 20.0) -> bool:
        """Let `limit` seconds of the table's time pass, or as much as it takes until something is so."""
        end = self.now + int(limit * SECOND)
        while not until():
            if self.now >= end:
                return False
            self._turn()
        return True

    def give(self, received: Received) -> None:
        for send in self.core.step(received, self.now):
            if isinstance(send, Write):
                self.port.write(send.data)
                self._to_robot += len(send.data) if self._open else 0
            elif isinstance(send, Publish) and isinstance(send.message, Motion):
                self.motions.append(send.message)

    def _wait(self, until: Callable[[], bool]) -> None:
        """Wait until bytes have passed through the kernel, or the port's thread has noticed something."""
        deadline = time.monotonic() + PATIENCE
        while not until():
            assert time.monotonic() < deadline, "it did not come to that"
            with contextlib.suppress(Empty):
                self._take(self._queue.get(timeout=0.01))

    def _take(self, event: object) -> None:
        assert isinstance(event, Captured)
        if event.value is None:
            self._open = not event.error
        else:
            self._to_driver -= len(event.value)
            event = Captured(event.device, event.value, self.now)
        self.give(event)

    def _turn(self) -> None:
        self.now += SECOND // 1000
        if not self._open:
            self._wait(lambda: self._open or self.terminal is None)
        if self.terminal is not None:
            self._feed(self.terminal)
            data = self.firmware.advance(self.now, NOTHING, None)
            self.terminal.write(data)
            self._to_driver += len(data)
            self._wait(lambda: self._to_driver == 0)
        if self.now * 30 // SECOND != self._frame:
            self._frame = self.now * 30 // SECOND
            x, y, heading = float(self.body.x), float(self.body.y), math.remainder(self.body.heading, math.tau)
            self._tracks.append(Track(stamp=self.now, x=x, y=y, heading=heading))
        while self._tracks and self._tracks[0].stamp < self.now - 40_000_000:
            track = self._tracks.popleft()
            self.give(Arrived("hider/track", track))
            self.give(Arrived("seeker/track", Track(stamp=track.stamp, x=0.9, y=0.9, heading=0.0)))
        wake = self.core.wake_at()
        if wake is not None and wake <= self.now:
            self.give(Woken())

    def _feed(self, terminal: PseudoTerminal) -> None:
        """Let the firmware read what the driver has written."""
        deadline = time.monotonic() + PATIENCE
        while self._to_robot > 0:
            assert time.monotonic() < deadline, f"{self._to_robot} bytes did not come"
            data = terminal.read()
            self._to_robot -= len(data)
            self.firmware.feed(data, self.now)


def test_primitives_over_a_real_pseudo_terminal_and_a_cable_pulled_in_mid_game(tmp_path: Path) -> None:
    table = RealTable(tmp_path / "hider")
    try:
        x, y, heading = draw_start(NOTHING, 1.2, 1.2, 5, 0.25, 0.45)[0]
        table.body.x, table.body.y, table.body.heading = x + 0.001, y, 10.0 * math.radians(heading)
        table.run(lambda: False, 0.3)
        table.give(Arrived("episode", Episode(stamp=table.now, episode=1, seed=5, phase="setup")))
        table.give(Arrived("layout", Layout(stamp=table.now, episode=1)))
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

        table.unplug()
        step_both(table, 5, "forward")
        assert table.run(lambda: len(table.motions) == 7, 3.0)
        assert table.motions[-1].result == "stopped"
        assert table.run(lambda: str(table.path) in table.core.trouble, 3.0)
        table.plug_in()
        assert table.run(lambda: table.core.trouble == "", 5.0), table.core.trouble
        step_both(table, 6, "forward")
        assert table.run(lambda: len(table.motions) == 8, 4.0)
        assert table.motions[-1].result == "completed"
    finally:
        table.close()


def step_both(table: RealTable, step: int, primitive: Primitive) -> None:
    table.give(Arrived("hider/command", Command(stamp=1, episode=1, step=step, primitive=primitive)))
    table.give(Arrived("seeker/command", Command(stamp=1, episode=1, step=step, primitive="stay")))
