"""Old logs read for ever: the rules of `schemas.evolution`, and the committed logs and descriptions they protect."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import msgspec
import pytest
from mcap.reader import make_reader

from schemas.evolution import RETIRED, SCHEMA_VERSION, describe, violations
from tests.golden.make_log import GOLDEN
from vantage.log import read

Edit = Callable[[dict[str, dict[str, dict[str, Any]]]], object]

DESCRIPTIONS = sorted(GOLDEN.glob("schemas_v*.json"))
LOGS = sorted(GOLDEN.glob("log_v*.mcap"))


@pytest.mark.parametrize("path", DESCRIPTIONS, ids=lambda path: path.stem)
def test_messages_keep_their_word(path: Path) -> None:
    assert violations(json.loads(path.read_text()), describe(), RETIRED) == []


def test_every_version_has_its_description_and_its_log() -> None:
    expected = list(range(1, SCHEMA_VERSION + 1))
    for paths in (DESCRIPTIONS, LOGS):
        assert sorted(int(re.sub(r"\D", "", path.stem)) for path in paths) == expected
    newest = json.loads((GOLDEN / f"schemas_v{SCHEMA_VERSION}.json").read_text())
    assert newest == describe(), "the messages changed: follow schemas/evolution.py"


@pytest.mark.parametrize("path", LOGS, ids=lambda path: path.stem)
def test_golden_logs_read(path: Path) -> None:
    records = list(read(path))
    for record in records:
        message = record.decode()
        held = msgspec.to_builtins(message, builtin_types=(bytes,))
        written = msgpack.unpackb(record.payload)
        gone = RETIRED.get(type(message).__name__, {})
        kept = {name: value for name, value in written.items() if name not in gone}
        assert kept == _as_far_as_written(held, kept)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        described = {schema.name for schema in reader.get_summary().schemas.values()}
        count = sum(1 for _ in reader.iter_messages())
    version = int(re.sub(r"\D", "", path.stem))
    known = json.loads((GOLDEN / f"schemas_v{version}.json").read_text())["types"]
    assert described == {type(record.decode()).__name__ for record in records} <= set(known)
    assert count == len(records) == 2 * len({record.key for record in records})


def _as_far_as_written(held: Any, written: Any) -> Any:
    """What was decoded, without the fields, of nested types too, that the writer did not know yet."""
    if isinstance(written, dict):
        return {name: _as_far_as_written(held[name], value) for name, value in written.items()}
    if isinstance(written, list):
        assert len(held) == len(written)
        return [_as_far_as_written(item, value) for item, value in zip(held, written, strict=True)]
    return held


def test_no_message_type_lacks_an_example() -> None:
    newest = {type(record.decode()).__name__ for record in read(GOLDEN / f"log_v{SCHEMA_VERSION}.mcap")}
    structs = set(describe()["types"])
    nested = {"Rules", "Players", "Box", "Intrinsics", "InputHealth"}
    assert newest == structs - nested


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        (lambda types: types["Pose"].pop("heading"), "Pose.heading: vanished; list it in RETIRED"),
        (lambda types: types.pop("Gap"), "Gap: the type vanished"),
        (lambda types: types["Pose"]["x"].update(type="int"), "Pose.x: changed from float to int"),
        (lambda types: types["Tick"].update(round={"type": "int", "required": True}), "Tick.round: a new field needs a default"),
        (lambda types: types["Tick"]["late"].update(required=True), "Tick.late: lost its default"),
        (lambda types: types["Command"]["primitive"]["choices"].remove("stay"), "no longer accepts ['stay']"),
        (lambda types: types["Rules"].pop("catching"), "Rules.catching: vanished"),
        (lambda types: types["Tick"].update(round={"type": "int", "required": False}), "raise SCHEMA_VERSION above"),
    ],
)
def test_every_breach_is_named(edit: Edit, told: str) -> None:
    old = describe()
    new = copy.deepcopy(old)
    edit(new["types"])
    assert any(told in text for text in violations(old, new, {}))


def test_a_retired_field_may_go_but_not_come_back() -> None:
    old = describe()
    new = copy.deepcopy(old)
    del new["types"]["Pose"]["heading"]
    new["version"] += 1
    assert violations(old, new, {"Pose": {"heading": 2}}) == []
    assert violations(old, old, {"Pose": {"heading": 2}}) == ["Pose.heading: retired in version 2, its name must not come back"]


def test_a_field_with_a_default_may_come() -> None:
    old = describe()
    new = copy.deepcopy(old)
    new["types"]["Pose"]["covariance"] = {"type": "float", "required": False}
    new["version"] += 1
    assert violations(old, new, {}) == []
