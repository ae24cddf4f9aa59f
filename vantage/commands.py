"""What `vantage up`, `status`, `logs`, `down`, `check` and `play` do, and how they talk to people."""

from __future__ import annotations

import json
import os
import shlex
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from vantage.deployment import Deployment, DeploymentError, configuration_of, deployments
from vantage.printable import counted, printable
from vantage.watch import HealthWatch, Verdict, diagnosis

console = Console(highlight=False)

NameOfDeployment = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="[DEPLOYMENT]")]


@dataclass(frozen=True)
class Where:
    """Which deployment, and where it runs."""

    deployment: NameOfDeployment = "simulation"
    """A configuration of compose/."""
    folder: Path | None = None
    """Private runtime folder; default /tmp/vantage-USERID/DEPLOYMENT. Keep it short: it holds unix sockets."""

    def find(self) -> Deployment:
        return Deployment(self.deployment, self.folder)


@dataclass(frozen=True)
class Up(Where):
    """Start a deployment and wait until every service is healthy.

    Examples:
        vantage up simulation
        vantage up simulation --logs /data/logs --with planner="--value binary" referee="--autoplay"
    """

    logs: Path = Path("logs")
    """Where the recorder writes its MCAP logs."""
    extra: Annotated[tuple[str, ...], tyro.conf.arg(name="with", metavar="NAME=ARGUMENTS")] = ()
    """Arguments added to the command of a service; `python -m services.NAME --help` lists them."""
    timeout: float = 60.0
    """Seconds to wait for all services to be healthy."""


@dataclass(frozen=True)
class Status(Where):
    """Show how each service does: process, restarts, memory, and what it complains about.

    Ends with exit code 0 only if all are healthy.

    Examples:
        vantage status
        vantage status --json
    """

    json: bool = False
    """Print JSON for programs instead of a table."""


@dataclass(frozen=True)
class Logs:
    """Show what a service printed.

    Examples:
        vantage logs planner
        vantage logs planner --follow
    """

    service: tyro.conf.Positional[str]
    """A service of the deployment, or `supervisord`."""
    deployment: str = "simulation"
    """A configuration of compose/."""
    folder: Path | None = None
    """Private runtime folder, as given to `vantage up`."""
    follow: bool = False
    """Go on printing what comes, until Ctrl-C."""
    lines: int = 40
    """How many of the last lines to show."""


@dataclass(frozen=True)
class Down(Where):
    """Stop a deployment.

    Example: vantage down simulation
    """


@dataclass(frozen=True)
class Check:
    """Look at a deployment without starting it: every command exists, every input has exactly one publisher.

    Examples:
        vantage check
        vantage check simulation
    """

    deployment: NameOfDeployment = ""
    """A configuration of compose/; all of them if not given."""


def up(settings: Up) -> int:
    """Start a deployment; stop it again if a service does not come up."""
    deployment = settings.find()
    started = time.monotonic()
    deployment.start(settings.logs, _extra_arguments(settings.extra))
    try:
        with HealthWatch(deployment) as watch, Live(console=console, auto_refresh=False, transient=True) as live:

            def show(verdicts: Sequence[Verdict]) -> None:
                if console.is_terminal:
                    live.update(_progress(verdicts), refresh=True)

            verdicts = watch.wait_until_healthy(settings.timeout, show)
        if why := diagnosis(deployment, verdicts):
            raise DeploymentError(f"{settings.deployment} did not come up, and is stopped again\n{why}")
    except BaseException:
        deployment.stop()
        raise
    memory = _mebibytes(sum(verdict.process.memory for verdict in verdicts) + deployment.supervisor_memory())
    took = time.monotonic() - started
    console.print(f"{settings.deployment} is up: {len(verdicts)} services healthy after {took:.1f} s, {memory} of memory")
    if address := deployment.console_address():
        console.print(f"watch and play in a browser: [bold]{_escaped(address)}[/]", soft_wrap=True)
    folder = "" if settings.folder is None else f" --folder {shlex.quote(str(settings.folder))}"
    name = "" if settings.deployment == "simulation" else f" {settings.deployment}"
    where = f" --deployment{name}" if name else ""
    first = ("replay LOG", "play a log on it") if settings.deployment == "replay" else (f"play --seed 7{where}", "play a game")
    steps = (first, (f"status{name}", "how the services do"), (f"down{name}", "stop them"))
    for words, meaning in steps:
        console.print(f"  {f'vantage {words}{folder}':<24} {meaning}", soft_wrap=True)
    console.print(f"recordings: {settings.logs}   runtime folder: {deployment.folder}", soft_wrap=True)
    return 0


def status(settings: Status) -> int:
    """Print how each service does; 0 if all are healthy, else 1."""
    deployment = settings.find()
    deployment.processes()
    with HealthWatch(deployment) as watch:
        watch.listen(1.2)
        verdicts = watch.verdicts()
    healthy = all(verdict.healthy for verdict in verdicts)
    supervisor = deployment.supervisor_memory()
    if settings.json:
        document = {
            "deployment": settings.deployment,
            "folder": str(deployment.folder),
            "healthy": healthy,
            "memory_bytes": sum(verdict.process.memory for verdict in verdicts) + supervisor,
            "console": deployment.console_address(),
            "services": [verdict.as_dict() for verdict in verdicts],
        }
        print(json.dumps(document, indent=2))
    else:
        console.print(_table(verdicts, supervisor))
        for verdict in verdicts:
            if not verdict.healthy:
                console.print(f"[red]{_escaped(verdict.process.name)}[/]: {_escaped(verdict.trouble)}", soft_wrap=True)
        if address := deployment.console_address():
            console.print(f"console: {_escaped(address)}", soft_wrap=True)
    return 0 if healthy else 1


def logs(settings: Logs) -> int:
    """Print the end of a service's log, and with `follow` what comes after."""
    deployment = Deployment(settings.deployment, settings.folder)
    path = deployment.log_of(settings.service)
    text = deployment.tail(settings.service, settings.lines)
    if text:
        print(text, flush=True)
    if settings.follow:
        _follow(path)
    return 0


def down(settings: Down) -> int:
    """Stop a deployment."""
    configuration_of(settings.deployment)  # a misspelt name must not stop another deployment
    deployment = settings.find()
    stopped = deployment.stop()
    count = len(stopped.orphans)
    orphans = f"{counted(count, 'service')} ({', '.join(stopped.orphans)})"
    were = "was" if count == 1 else "were"
    if stopped.supervisor and count:
        console.print(f"{settings.deployment} is down; {orphans} outlived supervisord and {were} ended", soft_wrap=True)
    elif stopped.supervisor:
        console.print(f"{settings.deployment} is down")
    elif count:
        ended = f"supervisord was gone, {orphans} still ran and {were} ended"
        console.print(f"{settings.deployment} is down: {ended}", soft_wrap=True)
    else:
        console.print(f"{settings.deployment} was not up in {deployment.folder}", soft_wrap=True, markup=False)
    return 0


def check(settings: Check) -> int:
    """Print what is wrong with the deployments; 0 if nothing is."""
    from vantage.check import check as troubles_with

    sound = True
    for name in [settings.deployment] if settings.deployment else deployments():
        troubles = troubles_with(name)
        sound = sound and not troubles
        console.print(f"{name}: {'sound' if not troubles else f'{len(troubles)} troubles'}")
        for trouble in troubles:
            console.print(f"  {trouble}", soft_wrap=True)
    return 0 if sound else 1


def _extra_arguments(texts: Sequence[str]) -> dict[str, str]:
    """Return service -> arguments; those of a service that is named twice are joined."""
    extra: dict[str, str] = {}
    for text in texts:
        name, separator, arguments = text.partition("=")
        if not separator or not name:
            raise DeploymentError(f'--with wants NAME="ARGUMENTS", not {text!r}')
        extra[name] = f"{extra[name]} {arguments}" if name in extra else arguments
    return extra


def _progress(verdicts: Sequence[Verdict]) -> Table:
    table = Table.grid(padding=(0, 2))
    for verdict in verdicts:
        table.add_row(
            "[green]✓[/]" if verdict.healthy else "[yellow]…[/]",
            _escaped(verdict.process.name),
            verdict.state,
            _escaped(verdict.trouble),
        )
    return table


def _table(verdicts: Sequence[Verdict], supervisor_memory: int) -> Table:
    table = Table(show_footer=True, box=None, pad_edge=False, header_style="bold")
    total = sum(verdict.process.memory for verdict in verdicts) + supervisor_memory
    table.add_column("service", "with supervisord")
    table.add_column("state")
    table.add_column("pid", justify="right")
    table.add_column("restarts", str(sum(verdict.process.restarts for verdict in verdicts)), justify="right")
    table.add_column("up", justify="right")
    table.add_column("memory", _mebibytes(total), justify="right")
    table.add_column("bad", justify="right")
    table.add_column("lost", justify="right")
    for verdict in verdicts:
        row = verdict.as_dict()
        process = verdict.process
        table.add_row(
            _escaped(process.name),
            f"[{'green' if verdict.healthy else 'red'}]{verdict.state}[/]",
            str(process.pid or ""),
            str(process.restarts),
            _duration(process.uptime),
            _mebibytes(process.memory),
            str(row["bad"]),
            str(row["lost"]),
        )
    return table


def _follow(path: Path) -> None:
    """Print what is appended, also after the file was rotated, until interrupted."""
    stream = path.open(errors="replace")
    stream.seek(0, 2)
    while True:
        text = stream.read()
        if text:
            sys.stdout.write("\n".join(printable(line, len(line) + 1) for line in text.split("\n")))
            sys.stdout.flush()
            continue
        try:
            rotated = path.stat().st_ino != os.fstat(stream.fileno()).st_ino
        except FileNotFoundError:
            rotated = False
        if rotated:
            stream.close()
            stream = path.open(errors="replace")
        time.sleep(0.1)


def _one_line(text: str) -> str:
    return " ".join(printable(text).split())


def _escaped(text: str) -> str:
    """Return text of a service as one line that is safe to print with markup."""
    return escape(_one_line(text))


def _mebibytes(number: int) -> str:
    return f"{number / 2**20:.0f} MiB"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}h{minutes:02}m" if hours else f"{minutes}m{rest:02}s" if minutes else f"{rest}s"
