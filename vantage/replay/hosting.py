"""The deployment that a replay plays in: one that is up in the folder, or `compose/replay.conf`, started and stopped again."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console

from vantage.deployment import Deployment
from vantage.replay.trouble import ReplayError
from vantage.watch import HealthWatch

NAME = "replay"
RESTARTS = 3
"""A service that was started so often before it was ever healthy does not start at all."""


@contextmanager
def hosted(folder: Path | None, start: bool, patience: float, console: Console) -> Iterator[tuple[Deployment, list[str]]]:
    """Yield the deployment in `folder`, and the services that belong to it; starts and stops it if nothing is up there.

    Args:
        folder: None = the default one of `replay`.
        start: whether to start it.
        patience: s that its services may take to be healthy.

    Raises:
        ReplayError: a service does not come up.
        DeploymentError: the folder cannot be used.
    """
    deployment = Deployment(NAME, folder)
    if deployment.is_running():
        yield deployment, list(deployment.programs)
        return
    if not start:
        yield deployment, []
        return
    # Who was started here by hand stays, and the deployment would not get its names.
    deployment.start(deployment.folder / "logs", {})
    try:
        with console.status(f"starting {' and '.join(deployment.programs)}") if console.is_terminal else _plain(console):
            _wait_until_healthy(deployment, patience)
        yield deployment, list(deployment.programs)
    finally:
        deployment.stop()


@contextmanager
def _plain(console: Console) -> Iterator[None]:
    console.print("starting predictor and console")
    yield


def _wait_until_healthy(deployment: Deployment, patience: float) -> None:
    deadline = time.monotonic() + patience
    with HealthWatch(deployment) as watch:
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
