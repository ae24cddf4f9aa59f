"""Devices of a service: cameras and serial ports, each read by a thread of its own that hands what it got to the runtime.

A core never touches a device. It receives `Captured` for what came from one, and returns `Write` for what is to go to one.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

logger = logging.getLogger("vantage")

RETRY = 1.0
"""Seconds between attempts to open a device that is not there."""


@dataclass(slots=True)
class Captured:
    """Something came from a device.

    Attributes:
        device: its name.
        value: what it gave; None where the device was lost or could not be opened, and once when it was opened.
        stamp: of the capture, ns since the Unix epoch.
        error: why there is no value, for people; empty when the device was opened.
    """

    device: str
    value: Any
    stamp: int
    error: str = ""


@dataclass(slots=True)
class Write:
    """What a core sends to a device."""

    device: str
    data: bytes


class DeviceLost(Exception):
    """The device is not there, or gone; the text names it and says what to look at."""


class Device(Protocol):
    """A camera or a port. All but `write` are called by one thread."""

    name: str
    newest_only: bool
    """Whether a reader that falls behind wants the newest alone (a camera), or everything (a port)."""

    def open(self) -> None:
        """Open it, or raise DeviceLost."""
        ...

    def read(self) -> tuple[Any, int] | None:
        """Wait at most about 0.2 s for the next capture; return it with its stamp, or None. Raise DeviceLost when it is gone."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes; from any thread, without waiting. What cannot be sent is dropped: `read` will tell that it is gone."""
        ...

    def close(self) -> None:
        """Close it; the second time does nothing."""
        ...


class DeviceThread:
    """Reads one device, opens it again when it is gone, and posts `Captured` events.

    Of a `newest_only` device no more than one frame waits: one that nobody has taken yet is replaced.
    """

    def __init__(self, device: Device, post: Callable[[object], None], clock: Callable[[], int]) -> None:
        self.device = device
        self._post, self._clock = post, clock
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._newest: Captured | None = None
        self._thread = threading.Thread(target=self._run, name=f"device-{device.name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Stop reading and close the device; waits a second at most."""
        self._stopping.set()
        self._thread.join(1.0)

    def take(self) -> Captured | None:
        """Return the frame that waits, if this is the thread of a `newest_only` device."""
        with self._lock:
            newest, self._newest = self._newest, None
            return newest

    def _run(self) -> None:
        told = ""
        while not self._stopping.is_set():
            try:
                self.device.open()
                told = ""
                self._post(Captured(self.device.name, None, self._clock()))
                self._read_until_lost()
            except Exception as error:  # a device's library may raise anything; the service lives on
                text = str(error) or type(error).__name__
                if text != told:
                    told = text
                    logger.warning("%s: %s", self.device.name, text)
                self._post(Captured(self.device.name, None, self._clock(), text))
            self._close()
            self._stopping.wait(RETRY)

    def _close(self) -> None:
        try:
            self.device.close()
        except Exception as error:  # what is gone may refuse to be closed
            logger.warning("%s could not be closed: %s", self.device.name, error)

    def _read_until_lost(self) -> None:
        while not self._stopping.is_set():
            got = self.device.read()
            if got is None:
                continue
            captured = Captured(self.device.name, *got)
            if not self.device.newest_only:
                self._post(captured)
                continue
            with self._lock:
                waiting, self._newest = self._newest, captured
            if waiting is None:
                self._post(self)
