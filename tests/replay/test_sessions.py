"""The sessions of a replay on the bus, and the deployment around them."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from vantage.bus.zenoh_bus import ZenohBus
from vantage.deployment import CONFIGURATION, Deployment, configuration_of
from vantage.process_table import with_extra_arguments
from vantage.replay.hosting import check_arena
from vantage.replay.sessions import Sessions
from vantage.replay.trouble import ReplayError

SAID = {("tick", "referee"), ("hider/pose", "simulator")}


@pytest.fixture
def folder() -> Iterator[Path]:
    path = Path(tempfile.mkdtemp(prefix="v", dir="/tmp"))
    yield path
    shutil.rmtree(path, ignore_errors=True)


def test_a_second_replay_and_a_live_referee_are_told_apart(folder: Path) -> None:
    """Each holds the name of the referee."""
    with Sessions(SAID, folder, "table", (), ()), pytest.raises(ReplayError, match=r"another replay is playing in .*: quit it"):
        Sessions(SAID, folder, "table", (), ())
    with ZenohBus("referee", folder), pytest.raises(ReplayError, match=r"a referee is alive in .*vantage down"):
        Sessions(SAID, folder, "table", (), ())
    with Sessions(SAID, folder, "table", (), ()):  # what failed left nothing behind
        pass


def test_a_deployment_of_another_arena_is_not_taken_for_the_one_around_the_replay(folder: Path) -> None:
    text = configuration_of("replay").read_text()
    (folder / CONFIGURATION).write_text(text)
    check_arena(Deployment("replay", folder), "table")
    with pytest.raises(ReplayError, match="belongs to the arena table, and would hear nothing"):
        check_arena(Deployment("replay", folder), "lab")
    (folder / CONFIGURATION).write_text(with_extra_arguments(text, dict.fromkeys(("predictor", "console"), "--arena lab")))
    check_arena(Deployment("replay", folder), "lab")
