"""The deployment that a replay plays in: one that is up in the folder, or `compose/replay.conf`, started and stopped again."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

from rich.console import Console

from vantage.deployment import Deployment, configuration_of
from vantage.process_table import programs_of
from vantage.replay.trouble import ReplayError
from vantage.watch import HealthWatch

NAME = "replay"
RESTARTS = 3
"""A service that was started so often before it was ever healthy does not start at all."""


@contextmanager
def hosted(
    folder: Path | None, arena: str, start: bool, patience: float, console: Console
) -> Iterator[tuple[Deployment, list[str]]]:
    """Yield the deployment in `folder`, and the services that belong to it; starts and stops it if nothing is up there.

    Args:
        folder: None = the default one of `replay`.
        arena: its name, for what is started.
        start: whether to start it.
        patience: s that its services may take to be healthy.

    Raises:
        ReplayError: a service does not come up, or what is up belongs to another arena.
        DeploymentError: the folder cannot be used.
    """
    deployment = Deployment(NAME, folder)
    if deployment.is_supervised():
        check_arena(deployment, arena)
        yield deployment, list(deployment.programs)
        return
    if not start:
        yield deployment, []
        return
    # Who was started here by hand stays, and the deployment would not get its names.
    programs = list(programs_of(configuration_of(NAME)))
    deployment.start(deployment.folder / "logs", {name: f"--arena {shlex.quote(arena)}" for name in programs})
    try:
        starting = f"starting {' and '.join(programs)}"
        with console.status(starting) if console.is_terminal else _plain(console, starting):
            _wait_until_healthy(deployment, arena, patience)
        yield deployment, list(deployment.programs)
    finally:
        deployment.stop()


@contextmanager
def _plain(console: Console, text: str) -> Iterator[None]:
    console.print(text)
    yield


def check_arena(deployment: Deployment, arena: str) -> None:
    """Nothing, if the services of a deployment are on the bus of this arena.

    Raises:
        ReplayError: one is not.
    """
    for program in deployment.programs.values():
        named = [value for word, value in pairwise(program.command) if word == "--arena"]
        if named and named[-1] != arena:
            raise ReplayError(
                f"--arena {arena}: what is up in {deployment.folder} belongs to the arena {named[-1]}, and would hear nothing: "
                "stop it (`vantage down replay`), or replay elsewhere (--folder)"
            )


def _wait_until_healthy(deployment: Deployment, arena: str, patience: float) -> None:
    deadline = time.monotonic() + patience
    with HealthWatch(deployment, arena) as watch:
        while True:
            watch.listen(0.1)
            sick = [verdict for verdict in watch.verdicts() if not verdict.healthy]
            if not sick:
                return
            if time.monotonic() > deadline or any(verdict.process.restarts >= RESTARTS for verdict in sick):
                texts = [
                    f"{verdict.process.name}: {verdict.trouble}\n{deployment.tail(verdict.process.name)}".rstrip()
                    for verdict in sick
                ]
                raise ReplayError("\n".join(["the services around the replay do not come up:", *texts]))
