"""Small deployments of real processes: one service, in a folder with a short name."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from vantage import deployment
from vantage.deployment import Deployment
from vantage.occupants import Occupant, end, occupants

HERE = Path(__file__).parent
CONFIGURATION = """
[supervisord]
logfile=supervisord.log
pidfile=supervisord.pid
childlogdir=.

[unix_http_server]
file=supervisor.sock
chmod=0700

[rpcinterface:supervisor]
supervisor.rpcinterface_factory=supervisor.rpcinterface:make_main_rpcinterface

[program:referee]
command=python -m services.referee --folder . --arena table
autorestart=true
startsecs=1
startretries=1000
stopwaitsecs=3
redirect_stderr=true
stdout_logfile=referee.log
"""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if HERE in item.path.parents and "small" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.stack)


@pytest.fixture
def home() -> Iterator[Path]:
    """A private folder with a short name: sockets are made in it."""
    path = Path(tempfile.mkdtemp(prefix="v", dir="/tmp"))
    yield path
    shutil.rmtree(path, ignore_errors=True)


class Small:
    """A deployment `small` that consists of a referee."""

    def __init__(self, home: Path) -> None:
        self.logs = home / "logs"
        self.deployment = Deployment("small", home / "run")
        self.folder = self.deployment.folder

    def start(self) -> None:
        self.deployment.start(self.logs, {})

    def wait(self, so: Callable[[], object], what: str, timeout: float = 60.0) -> None:
        deadline = time.monotonic() + timeout
        while not so():
            assert time.monotonic() < deadline, f"{what}: not within {timeout:g} s; {self.deployment.tail('referee')}"
            time.sleep(0.02)

    def named(self, name: str) -> list[Occupant]:
        return [occupant for occupant in occupants(self.folder) if occupant.name == name]

    def wait_for_service(self) -> int:
        """Wait until the referee runs; returns its process id."""
        self.wait(lambda: "referee started" in self.deployment.tail("referee"), "the referee runs")
        return self.named("referee")[0].pid


@pytest.fixture
def small(home: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Small]:
    (home / "compose").mkdir()
    (home / "compose" / "small.conf").write_text(CONFIGURATION)
    monkeypatch.setattr(deployment, "COMPOSE", home / "compose")
    made = Small(home)
    yield made
    assert not end(made.folder, 3.0)
