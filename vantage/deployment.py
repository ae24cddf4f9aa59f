"""A deployment: the processes of one table, run by supervisord from a file of `compose/` in a private folder.

The folder holds the sockets of the bus and of supervisord, the configuration in force, one log a service, and `recordings`, a
link to where the recorder writes.
"""

from __future__ import annotations

import configparser
import contextlib
import os
import re
import shlex
import signal
import stat
import subprocess
import sys
import time
import xmlrpc.client
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vantage.errors import UserError

COMPOSE = Path(__file__).resolve().parent.parent / "compose"
CONFIGURATION = "deployment.conf"
DEPLOYMENT_NAME = "deployment.name"
"""File that says which configuration of compose/ is up."""
CONSOLE_ADDRESS = "console.address"
"""File in which the console writes where its page is."""
LONGEST_FOLDER = 80
"""A unix socket's path ends at about 108 characters; the name of the socket and supervisord's temporary ending need room."""

_SPAWNED = re.compile(r"spawned: '([^']+)' with pid")


class DeploymentError(UserError):
    """What went wrong and what to do, for people."""


@dataclass(frozen=True, slots=True)
class Program:
    """One row of the process table."""

    name: str
    command: tuple[str, ...]
    priority: int


@dataclass(frozen=True, slots=True)
class Process:
    """What supervisord and the kernel say of one service.

    Attributes:
        state: supervisord's word: STARTING, RUNNING, BACKOFF, STOPPING, EXITED, FATAL, STOPPED.
        pid: 0 when there is no process.
        restarts: times it was started again since `vantage up`.
        uptime: s.
        memory: proportional share of resident memory, bytes.
        complaint: supervisord's reason when there is no process.
    """

    name: str
    state: str
    pid: int
    restarts: int
    uptime: float
    memory: int
    complaint: str


def deployments() -> list[str]:
    """Return the names of the deployments in `compose/`."""
    return sorted(path.stem for path in COMPOSE.glob("*.conf"))


def configuration_of(name: str) -> Path:
    """Return the supervisord configuration of a deployment.

    Raises:
        DeploymentError: there is none of that name.
    """
    path = COMPOSE / f"{name}.conf"
    if not path.is_file():
        raise DeploymentError(
            f"there is no deployment `{name}`; there is: {', '.join(deployments()) or 'none at all in ' + str(COMPOSE)}"
        )
    return path


def programs_of(configuration: Path) -> dict[str, Program]:
    """Return the process table of a supervisord configuration, in order of start."""
    parser = configparser.RawConfigParser(inline_comment_prefixes=(";",))
    parser.read_string(configuration.read_text())
    programs = [
        Program(
            name=section.removeprefix("program:"),
            command=tuple(shlex.split(parser[section]["command"].replace("%%", "%"))),
            priority=int(parser[section].get("priority", "999")),
        )
        for section in parser.sections()
        if section.startswith("program:")
    ]
    return {program.name: program for program in sorted(programs, key=lambda program: program.priority)}


def with_extra_arguments(text: str, extra: Mapping[str, str]) -> str:
    """Return the text of a supervisord configuration with arguments added at the end of some programs' commands.

    Raises:
        DeploymentError: a program is not in the configuration.
    """
    waiting = dict(extra)
    lines = []
    program = ""
    for line in text.splitlines():
        header = re.match(r"\s*\[program:([^\]]+)\]", line)
        if line.lstrip().startswith("["):
            program = header.group(1) if header else ""
        if program in waiting and re.match(r"command\s*=", line):
            line = f"{line} {waiting.pop(program).replace('%', '%%')}"
        lines.append(line)
    if waiting:
        raise DeploymentError(f"no such service in this deployment: {', '.join(sorted(waiting))}")
    return "\n".join(lines) + "\n"


def memory_of(pid: int) -> int:
    """Return a process's proportional share of resident memory in bytes (PSS of smaps_rollup), 0 when it is gone."""
    try:
        for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError):
        pass
    return 0


def default_folder(name: str) -> Path:
    """Return where a deployment runs unless told otherwise: short, because socket paths must be."""
    return Path("/tmp") / f"vantage-{os.getuid()}" / name


class Deployment:
    """One deployment in one folder, running or not.

    Args:
        name: of the configuration in `compose/`.
        folder: private runtime folder; default `/tmp/vantage-<user id>/<name>`.
    """

    def __init__(self, name: str, folder: Path | None = None) -> None:
        self.name = name
        self.folder = (folder or default_folder(name)).absolute()

    def command(self, word: str) -> str:
        """Return what to type to do something with this deployment, in this folder: `vantage down simulation`."""
        elsewhere = "" if self.folder == default_folder(self.name) else f" --folder {self.folder}"
        return f"vantage {word} {self.name}{elsewhere}"

    @property
    def programs(self) -> dict[str, Program]:
        """The process table in force: of the running deployment, else of `compose/`."""
        in_force = self.folder / CONFIGURATION
        return programs_of(in_force if in_force.is_file() else configuration_of(self.name))

    def start(self, recordings: Path, extra: Mapping[str, str]) -> None:
        """Start supervisord, detached, and with it every service.

        Args:
            recordings: folder for the recorder's logs, made if missing.
            extra: service -> arguments added to its command.

        Raises:
            DeploymentError: it runs already, the folder cannot be used, or supervisord refuses.
        """
        text = with_extra_arguments(configuration_of(self.name).read_text(), extra)
        self._make_folder()
        if self.is_running():
            raise DeploymentError(f"{self.name} is up already in {self.folder}: stop it with `{self.command('down')}`")
        self._clear_folder()
        recordings.mkdir(parents=True, exist_ok=True)
        (self.folder / "recordings").symlink_to(recordings.absolute())
        (self.folder / CONFIGURATION).write_text(text)
        (self.folder / DEPLOYMENT_NAME).write_text(self.name)
        environment = dict(os.environ)
        environment["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{environment.get('PATH', os.defpath)}"
        command = [sys.executable, "-m", "supervisor.supervisord", "--configuration", CONFIGURATION]
        outcome = subprocess.run(
            command, cwd=self.folder, env=environment, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False
        )
        if outcome.returncode:
            raise DeploymentError(
                f"supervisord refuses {self.folder / CONFIGURATION}: {(outcome.stderr or outcome.stdout).strip()}"
            )
        deadline = time.monotonic() + 10
        while not self.is_running():
            if time.monotonic() > deadline:
                raise DeploymentError(
                    f"supervisord does not answer; its log: {self.folder / 'supervisord.log'}\n{self.tail('supervisord')}"
                )
            time.sleep(0.02)

    def stop(self) -> bool:
        """Stop every service and supervisord, in reverse order of start. Returns whether anything ran.

        Raises:
            DeploymentError: something did not end within 20 s.
        """
        pid = self._supervisor_pid()
        if pid == 0:
            return False
        try:
            self._supervisor().shutdown()
        except (OSError, xmlrpc.client.Error):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGTERM)
        deadline = time.monotonic() + 20
        while self._supervisor_pid() == pid:
            if time.monotonic() > deadline:
                raise DeploymentError(
                    f"supervisord (process {pid}) did not stop within 20 s; see {self.folder / 'supervisord.log'}"
                )
            # supervisord looks for the next process to stop once a second, and whenever it is asked something.
            self.is_running()
            time.sleep(0.02)
        return True

    def is_running(self) -> bool:
        """Return whether supervisord answers."""
        try:
            self._supervisor().getState()
        except (OSError, xmlrpc.client.Error):
            return False
        return True

    def processes(self) -> list[Process]:
        """Return every service's process, in order of start.

        Raises:
            DeploymentError: the deployment is not up.
        """
        try:
            rows: list[dict[str, Any]] = self._supervisor().getAllProcessInfo()
        except (OSError, xmlrpc.client.Error) as error:
            raise DeploymentError(f"{self.name} is not up in {self.folder}: start it with `{self.command('up')}`") from error
        starts = self._starts()
        order = {name: place for place, name in enumerate(self.programs)}
        return sorted(
            (
                Process(
                    name=row["name"],
                    state=row["statename"],
                    pid=row["pid"],
                    restarts=max(0, starts.get(row["name"], 0) - 1),
                    uptime=max(0.0, float(row["now"] - row["start"])) if row["pid"] else 0.0,
                    memory=memory_of(row["pid"]) if row["pid"] else 0,
                    complaint="" if row["pid"] else row["spawnerr"] or row["description"],
                )
                for row in rows
            ),
            key=lambda process: order.get(process.name, len(order)),
        )

    def supervisor_memory(self) -> int:
        """Return supervisord's own memory, bytes."""
        return memory_of(self._supervisor_pid())

    def log_of(self, service: str) -> Path:
        """Return the log file of a service, or of `supervisord`.

        Raises:
            DeploymentError: no such service, or it has not written yet.
        """
        names = [*self.programs, "supervisord"]
        if service not in names:
            raise DeploymentError(f"no service `{service}` in {self.name}; there is: {', '.join(names)}")
        path = self.folder / f"{service}.log"
        if not path.is_file():
            raise DeploymentError(f"{service} has written no log in {self.folder}: is {self.name} up?")
        return path

    def console_address(self) -> str:
        """Return the address of the console's page, with its token where it needs one; empty when there is no console."""
        try:
            return (self.folder / CONSOLE_ADDRESS).read_text().strip()
        except OSError:
            return ""

    def tail(self, service: str, lines: int = 12) -> str:
        """Return the last lines of a service's log, empty when there is none."""
        try:
            text = self.log_of(service).read_text(errors="replace")
        except (DeploymentError, OSError):
            return ""
        return "\n".join(text.splitlines()[-lines:])

    def _supervisor(self) -> Any:
        # supervisor is imported late: `vantage --help` must not wait for it.
        from supervisor.xmlrpc import SupervisorTransport

        transport = SupervisorTransport(None, None, f"unix://{self.folder / 'supervisor.sock'}")
        return xmlrpc.client.ServerProxy("http://127.0.0.1", transport=transport).supervisor

    def _supervisor_pid(self) -> int:
        """Process id of this folder's supervisord, 0 when none lives."""
        try:
            pid = int((self.folder / "supervisord.pid").read_text())
            words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
            here = Path(f"/proc/{pid}/cwd").resolve() == self.folder.resolve()
        except (OSError, ValueError):
            return 0
        return pid if here and any(b"supervisor" in word for word in words) else 0

    def _starts(self) -> dict[str, int]:
        counts: dict[str, int] = {}
        for path in (self.folder / "supervisord.log.1", self.folder / "supervisord.log"):
            if path.is_file():
                for name in _SPAWNED.findall(path.read_text(errors="replace")):
                    counts[name] = counts.get(name, 0) + 1
        return counts

    def _make_folder(self) -> None:
        if len(str(self.folder)) > LONGEST_FOLDER:
            raise DeploymentError(
                f"{self.folder} is too long for unix sockets ({LONGEST_FOLDER} characters at most): choose another --folder"
            )
        try:
            self.folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self.folder.mkdir(mode=0o700, exist_ok=True)
            found = self.folder.lstat()
        except OSError as error:
            raise DeploymentError(f"cannot make the runtime folder {self.folder}: {error.strerror}") from error
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
            raise DeploymentError(f"{self.folder} is not a folder of yours: choose another with --folder")
        self.folder.chmod(0o700)

    def _clear_folder(self) -> None:
        """Remove what an earlier run left: only names that a deployment makes."""
        written = (CONFIGURATION, DEPLOYMENT_NAME, CONSOLE_ADDRESS)
        for pattern in ("*.sock", "*.sock.*", "*.log", "*.log.[0-9]*", "supervisord.pid", *written):
            for path in self.folder.glob(pattern):
                path.unlink(missing_ok=True)
        link = self.folder / "recordings"
        if link.is_symlink():
            link.unlink()
        elif link.exists():
            raise DeploymentError(
                f"{link} is a real folder, of a deployment started by hand: move it away, or choose another --folder"
            )
