"""The ten-line examples of docs/architecture.md are run as they stand on the page."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace as replace_message
from numpy.typing import NDArray

import schemas
from learning.collect import CollectSettings, play_block
from learning.hiders.open_loop import OpenLoop
from learning.hiders.table import HIDERS
from schemas import Command, Pose, Topic
from schemas import messages as m
from vantage import service
from vantage.log import read
from vantage.service import Arrived, Declaration, Publish, Received, Send
from vantage.world import arena
from vantage.world.layout import make_layout

PAGE = Path(__file__).resolve().parents[2] / "docs" / "architecture.md"


def blocks(section: str) -> list[str]:
    text = PAGE.read_text().partition(f"## {section}\n")[2].partition("\n## ")[0]
    return re.findall(r"```\w+\n(.*?)```", text, re.DOTALL)


def test_the_service(monkeypatch: pytest.MonkeyPatch) -> None:
    row, core_text = blocks("Add a service")
    topic: Topic = eval(row, {"Topic": Topic, "m": m})
    monkeypatch.setitem(schemas.TOPICS, "closeness", topic)
    monkeypatch.setitem(schemas.TOPICS, "health/closeness", replace(schemas.TOPICS["health/planner"], key="health/closeness"))
    names = {
        "Declaration": Declaration, "Pose": Pose, "Received": Received, "Sequence": Sequence, "Send": Send, "Arrived": Arrived,
        "Publish": Publish, "math": math, "replace": replace_message,
    }  # fmt: skip
    exec(core_text, names)
    core: service.Core = names["ClosenessCore"]()  # type: ignore[operator,assignment]
    assert core.declaration.outputs[0] == topic.key
    poses = [Pose(stamp=1, episode=1, step=3, x=0.1 + 0.3 * i, y=0.2 + 0.4 * i, heading=0.0) for i in range(2)]
    assert core.step(Arrived("hider/pose", poses[0]), 0) == ()
    (sent,) = core.step(Arrived("seeker/pose", poses[1]), 0)
    assert isinstance(sent, Publish)
    assert isinstance(sent.message, topic.type)
    assert sent.message.x == pytest.approx(0.5)


def test_the_layout(tmp_path: Path) -> None:
    (text,) = blocks("Add a layout")
    path = tmp_path / "corner.json"
    path.write_text(text)
    boxes = make_layout(str(path), seed=1)
    assert len(boxes) == 3
    settings = CollectSettings(games=1, hider="goal-walk", steps=5, catching=False, layout=str(path))
    assert play_block(settings, range(1, 2), tmp_path / "game.mcap") == 5


def test_the_hider_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (class_text,) = blocks("Add a hider policy")
    names = {"OpenLoop": OpenLoop, "np": np, "NDArray": NDArray, "LEFT": arena.LEFT, "RIGHT": arena.RIGHT}
    exec(class_text, names)
    (row,) = re.findall(r"The row: `\"turner\": (.*),`", PAGE.read_text())
    monkeypatch.setitem(HIDERS, "turner", eval(row, names))
    settings = CollectSettings(games=2, hider="turner", steps=8, catching=False)
    play_block(settings, range(1, 3), tmp_path / "game.mcap")
    played: dict[int, set[str]] = {}
    for record in read(tmp_path / "game.mcap", topics=("hider/command",)):
        command = record.decode()
        assert isinstance(command, Command)
        played.setdefault(command.episode, set()).add(command.primitive)
    assert len(played) == 2
    assert all(primitives in ({"left"}, {"right"}) for primitives in played.values())
