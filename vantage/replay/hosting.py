"""The deployment that a replay plays in: one that is up in the folder, or `compose/replay.conf`, started and stopped again."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

from rich.console import Console

from vantage.deployment import Deployment, configuration_of
from vantage.process_table import programs_of
from vantage.replay.trouble import ReplayError
from vantage.watch import HealthWatch, diagnosis

NAME = "replay"


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
            with HealthWatch(deployment, arena) as watch:
                verdicts = watch.wait_until_healthy(patience)
        if why := diagnosis(deployment, verdicts):
            raise ReplayError(f"the services around the replay do not come up:\n{why}")
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
