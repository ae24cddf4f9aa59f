"""A deployment: the processes of one table, run by supervisord from a file of `compose/` in a private folder.

The folder holds the sockets of the bus and of supervisord, the configuration in force, one log a service, and `recordings`, a
link to where the recorder writes.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shlex
import signal
import tempfile
import time
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from schemas import SERVICES
from vantage.bus.names import is_held, living_names
from vantage.errors import UserError, explain
from vantage.occupants import SUPERVISOR, Occupant, end, memory_of, occupants, wait_until_empty
from vantage.printable import counted, printable
from vantage.private_folder import is_private, make_private
from vantage.process_table import Program, programs_of, with_extra_arguments, with_this_interpreter
from vantage.supervisor import Supervisor, Unreachable

COMPOSE = Path(__file__).resolve().parent.parent / "compose"
CONFIGURATION = "deployment.conf"
DEPLOYMENT_NAME = "deployment.name"
"""File that says which configuration of compose/ is up."""
CONSOLE_ADDRESS = "console.address"
"""File in which the console writes where its page is."""
CONSOLE_TOKEN = "console.token"
"""File of the console that holds what pages must offer; each `vantage up` makes a new one."""
LONGEST_FOLDER = 80
"""Bytes: a unix socket's path ends at 107; the name of the socket and supervisord's temporary ending need room."""
STOP_PATIENCE = 20.0
"""Seconds that supervisord may take to end all services and itself."""
ORPHAN_PATIENCE = 3.0
"""Seconds that a service may take to end after SIGTERM, as in compose/*.conf."""
FAREWELL = 8.0
"""Seconds that `start` waits for services whose supervisord was just killed: they end by themselves."""

_SPAWNED = re.compile(r"spawned: '([^']+)' with pid")


class DeploymentError(UserError):
    """What went wrong and what to do, for people."""


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


def default_folder(name: str) -> Path:
    """Return where a deployment runs unless told otherwise: short, because socket paths must be."""
    return Path("/tmp") / f"vantage-{os.getuid()}" / name


@dataclass(frozen=True, slots=True)
class Stopped:
    """What `Deployment.stop` ended.

    Attributes:
        supervisor: whether supervisord ran.
        orphans: services that ran without it, or outlived it.
    """

    supervisor: bool = False
    orphans: tuple[str, ...] = ()


class Deployment:
    """One deployment in one folder, running or not.

    What runs in the folder is known by the processes that have it as their working directory (`vantage.occupants`), not by the
    files in it, which can be swept away. No method reads a file of a folder that another user can change.

    Args:
        name: of the configuration in `compose/`.
        folder: private runtime folder; default `/tmp/vantage-<user id>/<name>`.
    """

    def __init__(self, name: str, folder: Path | None = None) -> None:
        self.name = name
        self.folder = (folder or default_folder(name)).absolute()
        self._supervisor = Supervisor(self.folder)

    def command(self, word: str) -> str:
        """Return what to type to do something with this deployment, in this folder: `vantage down simulation`."""
        elsewhere = "" if self.folder == default_folder(self.name) else f" --folder {shlex.quote(str(self.folder))}"
        return f"vantage {word} {self.name}{elsewhere}"

    @property
    def programs(self) -> dict[str, Program]:
        """The process table in force: of the running deployment, else of `compose/`."""
        in_force = self.folder / CONFIGURATION
        return programs_of(in_force if is_private(self.folder) and in_force.is_file() else configuration_of(self.name))

    def start(self, recordings: Path, extra: Mapping[str, str]) -> None:
        """Start supervisord, detached, and with it every service.

        Args:
            recordings: folder for the recorder's logs, made if missing.
            extra: service -> arguments added to its command.

        Raises:
            DeploymentError: something runs in the folder already, nothing can be recorded, or supervisord refuses.
            NotPrivate: another user can change the folder.
        """
        text = with_this_interpreter(with_extra_arguments(configuration_of(self.name).read_text(), extra))
        self._make_folder()
        with self._locked():
            self._refuse_if_occupied(programs_of(configuration_of(self.name)))
            self._clear_folder()
            _check_recordings(recordings)
            (self.folder / "recordings").symlink_to(recordings.absolute())
            (self.folder / CONFIGURATION).write_text(text)
            (self.folder / DEPLOYMENT_NAME).write_text(self.name)
            try:
                self._supervisor.start(CONFIGURATION)
            except BaseException:
                self.stop()
                raise

    def stop(self) -> Stopped:
        """End supervisord, and every service in the folder whether it runs one or not: in reverse order of start, then by force.

        Raises:
            DeploymentError: something does not end.
        """
        if not is_private(self.folder):
            return Stopped()
        supervised = bool(self._supervisor_pid())
        if supervised:
            self._end_supervisor()
        orphans = [occupant.name for occupant in occupants(self.folder) if occupant.name != SUPERVISOR]
        if left := end(self.folder, ORPHAN_PATIENCE):
            raise DeploymentError(f"{_listed(left)} in {self.folder} cannot be ended: look at it with `ps` and end it by hand")
        return Stopped(supervised, tuple(orphans))

    def is_running(self) -> bool:
        """Return whether supervisord or any service runs in the folder, also by hand or in a container."""
        return is_private(self.folder) and bool(occupants(self.folder) or set(living_names(self.folder)) & set(SERVICES))

    def is_supervised(self) -> bool:
        """Return whether a supervisord runs in the folder and answers."""
        return is_private(self.folder) and bool(self._supervisor_pid()) and self._supervisor.answers()

    def processes(self) -> list[Process]:
        """Return every service's process, in order of start.

        Raises:
            DeploymentError: the deployment is not up, or only parts of it are.
        """
        if not is_private(self.folder):
            raise self._not_up()
        try:
            rows = self._supervisor.rows()
        except Unreachable as error:
            raise self._not_up() from error
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
        names = [*self.programs, SUPERVISOR]
        if service not in names:
            raise DeploymentError(f"no service `{service}` in {self.name}; there is: {', '.join(names)}")
        path = self.folder / f"{service}.log"
        if not is_private(self.folder) or not path.is_file():
            raise DeploymentError(f"{service} has written no log in {self.folder}: is {self.name} up?")
        return path

    def console_address(self) -> str:
        """Return the address of the console's page, with its token; empty when there is no console."""
        try:
            return (self.folder / CONSOLE_ADDRESS).read_text().strip() if is_private(self.folder) else ""
        except OSError:
            return ""

    def tail(self, service: str, lines: int = 12) -> str:
        """Return the last lines of a service's log, safe to print; empty when there is none."""
        try:
            text = self.log_of(service).read_text(errors="replace")
        except (DeploymentError, OSError):
            return ""
        return "\n".join(printable(line) for line in text.splitlines()[-lines:])

    def _supervisor_pid(self) -> int:
        """Process id of this folder's supervisord, 0 when none lives."""
        # The oldest: one that is just starting a service is there twice.
        return next((occupant.pid for occupant in occupants(self.folder) if occupant.name == SUPERVISOR), 0)

    def _not_up(self) -> DeploymentError:
        """Return the error that describes what runs instead of a whole deployment."""
        found = occupants(self.folder)
        services = [occupant for occupant in found if occupant.name != SUPERVISOR]
        if len(services) < len(found):
            return DeploymentError(
                f"supervisord (process {self._supervisor_pid()}) runs in {self.folder} but does not answer: "
                f"end it and its services with `{self.command('down')}`"
            )
        if services:
            return DeploymentError(
                f"supervisord is gone; {_listed(services)} still run{'s' if len(services) == 1 else ''} in {self.folder}: "
                f"`{self.command('down')}`"
            )
        return DeploymentError(f"{self.name} is not up in {self.folder}: start it with `{self.command('up')}`")

    def _starts(self) -> dict[str, int]:
        counts: dict[str, int] = {}
        for path in (self.folder / "supervisord.log.1", self.folder / "supervisord.log"):
            if path.is_file():
                for name in _SPAWNED.findall(path.read_text(errors="replace")):
                    counts[name] = counts.get(name, 0) + 1
        return counts

    def _make_folder(self) -> None:
        if len(os.fsencode(self.folder)) > LONGEST_FOLDER:
            raise DeploymentError(
                f"{self.folder} is too long for unix sockets ({LONGEST_FOLDER} bytes at most): choose another --folder"
            )
        if any(sign in str(self.folder) for sign in "#?;"):
            raise DeploymentError(f"{self.folder}: a folder for sockets must not have `#`, `?` or `;` in its path")
        make_private(self.folder)

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        """Hold the folder's lock: two `vantage up` at once must not both find the folder empty."""
        folder = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield
        except BlockingIOError:
            raise DeploymentError(f"another `vantage up` is starting in {self.folder}: wait for it") from None
        finally:
            os.close(folder)

    def _refuse_if_occupied(self, names: Collection[str]) -> None:
        if not self._supervisor_pid():
            wait_until_empty(self.folder, FAREWELL)
        elif self._supervisor.answers():
            raise DeploymentError(f"{self.name} is up already in {self.folder}: stop it with `{self.command('down')}`")
        elif self._supervisor.is_ending():  # asked by Ctrl-C in `vantage up`
            wait_until_empty(self.folder, STOP_PATIENCE)
        if occupants(self.folder):
            raise self._not_up()
        if taken := [name for name in living_names(self.folder) if name in names]:
            raise DeploymentError(
                f"{', '.join(taken)}: on the bus in {self.folder} already, started by hand or in a container: stop that first"
            )

    def _end_supervisor(self) -> None:
        """Ask supervisord to end, and wait until it has, or until it is plain that it does not."""
        try:
            self._supervisor.shutdown()
        except Unreachable:
            end_of_patience = time.monotonic() + ORPHAN_PATIENCE
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._supervisor_pid(), signal.SIGTERM)
        else:
            end_of_patience = time.monotonic() + STOP_PATIENCE
        while self._supervisor_pid() and time.monotonic() < end_of_patience:
            # supervisord looks for the next process to stop once a second, and whenever it is asked something.
            self._supervisor.answers()
            time.sleep(0.02)

    def _clear_folder(self) -> None:
        """Remove what an earlier run left: only names that a deployment makes, and nothing that a living process holds."""
        for lock in self.folder.glob("*.sock.lock"):
            if not is_held(lock):
                lock.with_suffix("").unlink(missing_ok=True)
                lock.unlink(missing_ok=True)
        written = (CONFIGURATION, DEPLOYMENT_NAME, CONSOLE_ADDRESS, CONSOLE_TOKEN)
        for pattern in ("supervisor.sock*", "*.log", "*.log.[0-9]*", "supervisord.pid", *written):
            for path in self.folder.glob(pattern):
                path.unlink(missing_ok=True)
        link = self.folder / "recordings"
        if link.is_symlink():
            link.unlink()
        elif link.exists():
            raise DeploymentError(
                f"{link} is a real folder, of a deployment started by hand: move it away, or choose another --folder"
            )


def _check_recordings(folder: Path) -> None:
    """Make the folder of the recordings and write something there for a moment.

    Raises:
        DeploymentError: that is impossible; the text has the reason.
    """
    from vantage.log.part import FOLDER_MODE  # other commands must not wait for what it imports

    try:
        folder.mkdir(FOLDER_MODE, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(bytes(65536))
            probe.flush()
    except OSError as error:
        reason = explain(OSError(error.errno, error.strerror))
        raise DeploymentError(f"nothing can be recorded in {folder}: {reason} (--logs)") from error


def _listed(found: Collection[Occupant]) -> str:
    """Return how many services these are, and their names."""
    return f"{counted(len(found), 'service')} ({', '.join(sorted(each.name for each in found))})"
