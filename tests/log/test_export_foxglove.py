"""The copy for Foxglove, its layout, and what holds for every format: nothing overwritten, nothing half."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from services.recorder.appearance import arena_appearance
from tests.log.exporting import real_log, write
from vantage.log import read
from vantage.log.export_formats import export_to
from vantage.log.target import ExportError, TargetExists, whole

LOOKS = arena_appearance()
VANTAGE = Path(sys.executable).parent / "vantage"


def leaves(tree: Any) -> list[str]:
    return [tree] if isinstance(tree, str) else leaves(tree["first"]) + leaves(tree["second"])


def topics_in(value: Any) -> list[str]:
    """Every topic that a layout names."""
    if isinstance(value, dict):
        named = [key for key in value if key.startswith("viewer/")]
        return named + [topic for part in value.values() for topic in topics_in(part)]
    if isinstance(value, list):
        return [topic for part in value for topic in topics_in(part)]
    return [value.partition(".")[0]] if isinstance(value, str) and value.startswith("viewer/") else []


def test_the_layout_shows_the_topics_of_the_log_and_no_others(tmp_path: Path) -> None:
    export_to("foxglove", real_log(), tmp_path / "out.mcap", LOOKS)
    layout = json.loads((tmp_path / "out.layout.json").read_text())
    there = {record.key for record in read(tmp_path / "out.mcap", viewer=True)}
    named = set(topics_in(layout["configById"]))
    assert named <= there
    pictures = {f"viewer/{robot}/{part}" for robot in ("hider", "seeker") for part in ("color", "depth", "view")}
    assert pictures | {"viewer/scene", "viewer/hider/plan/picture", "viewer/predictor/views", "viewer/text"} <= named
    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])
    few = tmp_path / "few.mcap"
    write(few, [record for record in read(real_log()) if record.key in ("episode", "layout")])
    export_to("foxglove", few, None, LOOKS)
    small = json.loads((tmp_path / "few-viewer.layout.json").read_text())
    assert set(small["configById"]) == {"3D!scene", "RosOut!text"}


def test_one_game_is_its_time_of_the_log(tmp_path: Path) -> None:
    export_to("foxglove", real_log(), tmp_path / "two.mcap", LOOKS, episode=2)
    numbers = {record.decode().episode for record in read(tmp_path / "two.mcap")}
    assert numbers == {2}
    with pytest.raises(ExportError, match="no game 9 in this log; there is: 1, 2, 3"):
        export_to("foxglove", real_log(), tmp_path / "nine.mcap", LOOKS, episode=9)


def test_nothing_is_overwritten_without_being_asked(tmp_path: Path) -> None:
    (tmp_path / "out.layout.json").write_text("mine")
    with pytest.raises(TargetExists, match="--force"):
        export_to("foxglove", real_log(), tmp_path / "out.mcap", LOOKS)
    assert (tmp_path / "out.layout.json").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["out.layout.json"]
    export_to("foxglove", real_log(), tmp_path / "out.mcap", LOOKS, force=True)
    assert json.loads((tmp_path / "out.layout.json").read_text())["layout"]


def test_a_folder_of_somebody_else_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("mine")
    with pytest.raises(TargetExists, match="never replaced"):
        export_to("lerobot", real_log(), tmp_path / "thesis", LOOKS, force=True)
    assert (tmp_path / "thesis" / "chapter.tex").read_text() == "mine"


def test_what_fails_half_way_leaves_nothing(tmp_path: Path) -> None:
    def fail(target: Path) -> None:
        with whole(target) as partial:
            partial.mkdir()
            (partial / "a").write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail(tmp_path / "target")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("format", ["foxglove", "rerun", "lerobot", "video"])
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_export_leaves_nothing_under_its_name(tmp_path: Path, format: str, sent: signal.Signals) -> None:
    target = tmp_path / "target"
    command = [VANTAGE, "log", "export", real_log(3, 250), "--to", format, "--output", target]
    if format in ("rerun", "video"):
        command += ["--episode", "2"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while process.poll() is None and not any(path.name.startswith(".target.partial") for path in tmp_path.iterdir()):
        assert time.monotonic() < deadline
        time.sleep(0.005)
    process.send_signal(sent)
    _, said = process.communicate(timeout=60)
    assert process.returncode != 0
    assert not target.exists()
    if sent == signal.SIGINT:
        assert list(tmp_path.iterdir()) == []
        assert "Traceback" not in said


def test_a_cut_log_gives_what_is_whole_and_exit_code_2(tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(real_log().read_bytes()[: real_log().stat().st_size * 6 // 10])
    for format in ("foxglove", "rerun", "lerobot", "video"):
        done = subprocess.run(
            [VANTAGE, "log", "export", cut, "--to", format, "--output", tmp_path / format], capture_output=True, text=True
        )
        assert done.returncode == 2, done.stderr
        assert "breaks off" in done.stderr
        assert (tmp_path / format).exists()


def test_a_missing_package_is_one_line(tmp_path: Path) -> None:
    """As on a machine without the extra `viewers`."""
    without = "import sys; sys.modules.update({'rerun': None, 'pyarrow': None, 'av': None}); from vantage.cli import main; main()"
    for format, package in (("rerun", "rerun-sdk"), ("lerobot", "pyarrow"), ("video", "av")):
        words = [sys.executable, "-c", without, "log", "export", real_log(), "--to", format, "--output", tmp_path / "out"]
        done = subprocess.run(words, capture_output=True, text=True)
        assert done.returncode == 1
        assert done.stderr.count("\n") == 1
        assert f"{package} is not installed" in done.stderr and "[viewers]" in done.stderr
