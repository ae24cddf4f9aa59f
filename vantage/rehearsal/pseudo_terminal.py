"""A pseudo-terminal that stands for a serial port: the emulated robot's end, and a link at a path for the driver's."""

from __future__ import annotations

import contextlib
import os
import tty
from pathlib import Path


class PseudoTerminal:
    """The far end of a serial line.

    The link leads through this process: once it has ended, however that came, the link leads nowhere. One to `/dev/pts/7` would
    lead to whoever is given that number next, and the driver would take somebody's terminal for its robot.

    Args:
        path: where a link to the driver's end is made; an old link there is replaced. Its folder must exist.

    Raises:
        OSError: no pseudo-terminal is to be had, or the path cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._robot, self._driver = os.openpty()
        tty.setraw(self._driver)
        os.set_blocking(self._robot, False)
        # The driver's end stays open here, too: a driver that comes and goes leaves the line as it is.
        through = f"/proc/{os.getpid()}/fd/{self._driver}"
        self._link = through if os.path.exists(through) else os.ttyname(self._driver)
        try:
            temporary = self.path.with_name(f".{self.path.name}.{os.getpid()}")
            temporary.unlink(missing_ok=True)
            temporary.symlink_to(self._link)
            temporary.replace(self.path)
        except OSError:
            os.close(self._robot)
            os.close(self._driver)
            raise

    def fileno(self) -> int:
        """Return the robot's end, for `select`."""
        return self._robot

    def read(self) -> bytes:
        """Return what the driver has written since; empty when nothing."""
        data = b""
        with contextlib.suppress(OSError):
            while piece := os.read(self._robot, 4096):
                data += piece
        return data

    def write(self, data: bytes) -> None:
        """Send to the driver, without waiting; what finds no room (nobody reads) is lost."""
        with contextlib.suppress(OSError):
            os.write(self._robot, data)

    def close(self) -> None:
        """Unplug: the link goes, the driver's end hangs up. The second time does nothing."""
        if self._robot < 0:
            return
        with contextlib.suppress(OSError):
            if os.readlink(self.path) == self._link:
                self.path.unlink()
        os.close(self._robot)
        os.close(self._driver)
        self._robot = self._driver = -1
