from __future__ import annotations

import json
import math
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vantage.tracking.errors import UnusableTable
from vantage.tracking.table import CornerTag, ObstacleTag, RobotTag, check_table, default_table, load_table, save_table


def test_default_is_usable_and_comes_back(tmp_path: Path) -> None:
    table = default_table()
    save_table(table, tmp_path / "deep" / "table.json")
    assert load_table(tmp_path / "deep" / "table.json") == table
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["table.json"]


@given(st.floats(0.01, 0.08), st.floats(0.0, 0.4), st.floats(-0.1, 0.1), st.floats(-math.pi, math.pi))
def test_any_robot_tag_comes_back(size: float, height: float, forward: float, heading: float) -> None:
    tag = RobotTag(id=3, size=size, height=height, forward=forward, left=-forward, heading=heading)
    assert msgspec.json.decode(msgspec.json.encode(tag), type=RobotTag) == tag


def test_unusable_tables_are_named() -> None:
    table = default_table()
    replace = msgspec.structs.replace
    with pytest.raises(UnusableTable, match="tag 20 stands more than once"):
        check_table(replace(table, robots={"hider": RobotTag(id=20), "seeker": RobotTag(id=1)}))
    with pytest.raises(UnusableTable, match="hider and seeker, it has: hider"):
        check_table(replace(table, robots={"hider": RobotTag(id=0)}))
    with pytest.raises(UnusableTable, match="family tag25h9"):
        check_table(replace(table, family="tag25h9"))
    with pytest.raises(UnusableTable, match="does not fit on its box"):
        check_table(replace(table, obstacles=(ObstacleTag(id=10, half_width=0.02, half_depth=0.1),)))
    with pytest.raises(UnusableTable, match="too close together"):
        check_table(replace(table, corners=tuple(CornerTag(id=20 + i, x=0.1 * i, y=0.0) for i in range(4))))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "not the description of a table"),
        (b"{", "not the description of a table"),
        (b"\xff\xfe", "not the description of a table"),
        (b"[" * 100_000, "not the description of a table"),
        (b" " * 1_000_001, "more than 1000000 bytes"),
        (b'{"corners": [], "robots": {}}', "corners"),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "table.json"
    path.write_bytes(content)
    with pytest.raises(UnusableTable, match=says):
        load_table(path)


def test_wrong_fields_are_named_with_their_place(tmp_path: Path) -> None:
    path = tmp_path / "table.json"
    save_table(default_table(), path)
    content = json.loads(path.read_text())
    content["robots"]["hider"]["id"] = 600
    path.write_text(json.dumps(content))
    with pytest.raises(UnusableTable, match=r"robots.*\.id"):
        load_table(path)
    content["robots"]["hider"] = {"id": 0, "hieght": 0.1}
    path.write_text(json.dumps(content))
    with pytest.raises(UnusableTable, match="hieght"):
        load_table(path)


def test_missing_file_and_unwritable_place(tmp_path: Path) -> None:
    with pytest.raises(UnusableTable, match="No such file"):
        load_table(tmp_path / "none.json")
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        save_table(default_table(), tmp_path / "file" / "table.json")
