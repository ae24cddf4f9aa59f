"""The serial port as a device, over a real pseudo-terminal in real time; and the driver's whole way through it."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from schemas import Command, Episode, Layout, Motion, Primitive, Rules, Track
from services.robot.core import RobotCore
from services.robot.serial_port import SerialPort
from services.robot.settings import RobotSettings
from vantage.bus import InProcessNetwork
from vantage.rehearsal.body import Body, BodySettings
from vantage.rehearsal.firmware import Firmware, FirmwareSettings
from vantage.rehearsal.pseudo_terminal import PseudoTerminal
from vantage.service import SECOND, DeviceLost, Runtime, steady_clock
from vantage.world.layout import boxes_array

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
        for _ in range(20):
            port.read()
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


class Rehearsal:
    """An emulated hider behind a pseudo-terminal and a camera of 30 frames a second, in real time, in a thread."""

    def __init__(self, network: InProcessNetwork, path: Path) -> None:
        self._bus = network.bus("tracker")
        self._path = path
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.body = Body(BodySettings(), 0.4, 0.4, 0.3)
        self.plugged = threading.Event()
        self.plugged.set()

    @contextmanager
    def running(self) -> Iterator[Rehearsal]:
        self._thread.start()
        try:
            yield self
        finally:
            self._stopping.set()
            self._thread.join()

    def _run(self) -> None:
        firmware = Firmware(self.body, FirmwareSettings(), seed=3)
        terminal: PseudoTerminal | None = None
        frame = 0
        while not self._stopping.wait(0.002):
            if self.plugged.is_set() and terminal is None:
                terminal = PseudoTerminal(self._path)
            elif not self.plugged.is_set() and terminal is not None:
                terminal.close()
                terminal = None
            now = steady_clock()
            if terminal is not None:
                firmware.feed(terminal.read(), now)
            data = firmware.advance(now, NOTHING, None)
            if terminal is not None and data:
                terminal.write(data)
            if now * 30 // SECOND != frame:
                frame = now * 30 // SECOND
                heading = math.remainder(self.body.heading, math.tau)
                self._bus.publish("hider/track", Track(stamp=now, x=float(self.body.x), y=float(self.body.y), heading=heading))
                self._bus.publish("seeker/track", Track(stamp=now, x=0.9, y=0.9, heading=0.0))
        if terminal is not None:
            terminal.close()
