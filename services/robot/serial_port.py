"""A serial port as a device of the driver."""

from __future__ import annotations

import contextlib
import os
import threading

import serial

from vantage.service import DeviceLost, steady_clock

WAIT = 0.1
"""Seconds that `read` waits at most."""


class SerialPort:
    """A robot's serial line, 8N1; see `vantage.service.device.Device`.

    Args:
        name: of the device: the robot's.
        path: such as `/dev/ttyUSB0`, or a pseudo-terminal.
        baud: bits a second.
    """

    newest_only = False

    def __init__(self, name: str, path: str, baud: int) -> None:
        self.name = name
        self.path = path
        self._baud = baud
        self._port: serial.Serial | None = None
        self._lock = threading.Lock()

    def open(self) -> None:
        try:
            port = serial.Serial(self.path, self._baud, timeout=WAIT, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            reason = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)
            raise DeviceLost(
                f"robot {self.name}: cannot open {self.path} ({reason}); is it plugged in and switched on?"
            ) from error
        with self._lock:
            self._port = port

    def read(self) -> tuple[bytes, int] | None:
        port = self._port
        if port is None:
            raise DeviceLost(f"robot {self.name}: {self.path} is not open")
        try:
            data = port.read(1)
            if data:
                data += port.read(port.in_waiting)
        except (serial.SerialException, OSError, TypeError) as error:  # TypeError: pyserial's, of a port closed meanwhile
            raise DeviceLost(f"robot {self.name}: {self.path} was unplugged") from error
        return (data, steady_clock()) if data else None

    def write(self, data: bytes) -> None:
        # Not pyserial's write: with a full buffer it waits, whatever its time-out. Its descriptor does not block.
        with self._lock, contextlib.suppress(OSError, serial.SerialException):
            if self._port is not None:
                os.write(self._port.fileno(), data)

    def close(self) -> None:
        with self._lock:
            port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(OSError, serial.SerialException):
                port.close()
