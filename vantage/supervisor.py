"""The supervisord of a folder: started, and asked over the unix socket that it makes there."""

from __future__ import annotations

import http.client
import os
import resource
import socket
import struct
import subprocess
import sys
import time
import xmlrpc.client
from pathlib import Path
from typing import Any

from vantage.errors import UserError
from vantage.printable import printable

SOCKET = "supervisor.sock"
OPEN_FILES = 1024
"""Files that supervisord insists on being able to open."""
START_PATIENCE = 10.0
"""Seconds within which it must answer for the first time."""
PATIENCE = 5.0
"""Seconds that an answer may take."""
_SHUTDOWN_STATE = 6
"""Fault by which it refuses every request once it was asked to end (`supervisor.xmlrpc.Faults`)."""

Unreachable = (OSError, http.client.HTTPException, xmlrpc.client.Error)
"""Raised by every request when supervisord is gone, does not answer in time, or has lost its socket."""


class SupervisorError(UserError):
    """supervisord cannot be started."""


class Supervisor:
    """The supervisord of one folder. `rows` and `shutdown` raise one of `Unreachable` when it does not answer."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._socket = folder / SOCKET

    def start(self, configuration: str) -> None:
        """Start it, detached, in the folder, and wait until it answers.

        Args:
            configuration: name of a file in the folder.

        Raises:
            SupervisorError: it refuses, or does not answer.
        """
        _raise_limit_on_open_files()
        environment = dict(os.environ)
        environment["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{environment.get('PATH', os.defpath)}"
        command = [sys.executable, "-m", "supervisor.supervisord", "--configuration", configuration]
        outcome = subprocess.run(
            command, cwd=self._folder, env=environment, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False
        )
        if outcome.returncode:
            complaint = printable((outcome.stderr or outcome.stdout).strip())
            raise SupervisorError(f"supervisord refuses {self._folder / configuration}: {complaint}")
        deadline = time.monotonic() + START_PATIENCE
        while not self.answers():
            if time.monotonic() > deadline:
                raise SupervisorError(f"supervisord does not answer; its log: {self._folder / 'supervisord.log'}")
            time.sleep(0.02)

    def answers(self) -> bool:
        """Return whether supervisord answers."""
        try:
            self._server().getState()
        except Unreachable:
            return False
        return True

    def is_ending(self) -> bool:
        """Return whether supervisord was asked to end, and waits for its processes to do so."""
        try:
            self._server().getState()
        except xmlrpc.client.Fault as fault:
            return fault.faultCode == _SHUTDOWN_STATE
        except Unreachable:
            return False
        return False

    def rows(self) -> list[dict[str, Any]]:
        """Return supervisord's own description of each process."""
        rows: list[dict[str, Any]] = self._server().getAllProcessInfo()
        return rows

    def shutdown(self) -> None:
        """Ask it to end every process, and then itself; it may be doing so already."""
        try:
            self._server().shutdown()
        except xmlrpc.client.Fault as fault:
            if fault.faultCode != _SHUTDOWN_STATE:
                raise

    def _server(self) -> Any:
        return xmlrpc.client.ServerProxy("http://localhost", transport=_Transport(self._socket)).supervisor


class _Transport(xmlrpc.client.Transport):
    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path

    def make_connection(self, host: object) -> http.client.HTTPConnection:
        return _Connection(self._path)


class _Connection(http.client.HTTPConnection):
    def __init__(self, path: Path) -> None:
        super().__init__("localhost", timeout=PATIENCE)
        self._path = path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(PATIENCE)
        self.sock.connect(os.fspath(self._path))
        if sys.platform == "linux":
            _, user, _ = struct.unpack("3i", self.sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i")))
            if user != os.geteuid():
                raise PermissionError(f"{self._path} belongs to a process of user {user}")


def _raise_limit_on_open_files() -> None:
    """Make room for the files of supervisord and of the services, which inherit the limit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and soft < OPEN_FILES:
        wanted = OPEN_FILES if hard == resource.RLIM_INFINITY else max(hard, OPEN_FILES)
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (OPEN_FILES, wanted))
        except (ValueError, OSError):
            raise SupervisorError(
                f"this shell may open {hard} files, and a deployment needs {OPEN_FILES}: `ulimit -n {OPEN_FILES}` in a new shell"
            ) from None
