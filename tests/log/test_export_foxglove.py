"""The copy for Foxglove, its layout, and what holds for every format: nothing overwritten, nothing half."""

from __future__ import annotations

import errno
import json
import re
import resource
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from msgspec import structs

from schemas import Control, Players, encode
from services.recorder.appearance import arena_appearance
from tests.log.exporting import PERSON, discard, real_log, write
from tests.log.making import START, game, records_of, write_record
from vantage.log import LogWriter, Record, find_logs, open_log, read
from vantage.log.episodes import games_of
from vantage.log.export_formats import export_to
from vantage.log.foxglove_layout import layout_of
from vantage.log.games import NoSuchGame
from vantage.log.part import ChunkLost, Part
from vantage.log.reader import NoSuchLog, parts_of
from vantage.log.target import ExportError, whole
from vantage.output import AlreadyExists

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


def test_the_layout_shows_the_arena_and_the_robots_as_they_look() -> None:
    looks = replace(LOOKS, arena_size=3.5, robot_colors={"hider": (1, 2, 255), "seeker": (16, 0, 3)})
    layout = layout_of(["viewer/hider/pose", "viewer/seeker/pose"], looks)["configById"]
    assert [path["color"] for path in layout["Plot!x"]["paths"]] == ["#0102ff", "#100003"]
    assert layout["Plot!y"]["maxYValue"] == 3.5
    assert layout["3D!scene"]["cameraState"]["targetOffset"] == [1.75, 1.75, 0]


def test_the_scene_colours_danger_as_every_other_picture_does() -> None:
    layout = layout_of(["viewer/hider/plan/values", "viewer/hider/plan/picture"], LOOKS)["configById"]
    shown = layout["3D!scene"]["topics"]["viewer/hider/plan/values"]
    ends = ["#{:02x}{:02x}{:02x}80".format(*LOOKS.danger[end]) for end in (0, -1)]
    assert (shown["colorField"], shown["gradient"]) == ("danger", ends)
    assert "danger" in layout["Image!hider-plan-picture"]["foxglovePanelTitle"]


def test_one_game_is_its_time_of_the_log(tmp_path: Path) -> None:
    export_to("foxglove", real_log(), tmp_path / "two.mcap", LOOKS, episode=2)
    own = [record for record in read(real_log()) if record.decode().episode == 2]
    copied = list(read(tmp_path / "two.mcap"))
    assert [(record.key, record.log_time) for record in copied] == [(record.key, record.log_time) for record in own]
    names_person = ("episode", "control")
    assert [r.payload for r in copied if r.key not in names_person] == [r.payload for r in own if r.key not in names_person]
    with pytest.raises(NoSuchGame, match="no game 9 in this log; there is: 1, 2, 3"):
        export_to("foxglove", real_log(), tmp_path / "nine.mcap", LOOKS, episode=9)


def test_nothing_is_overwritten_without_being_asked(tmp_path: Path) -> None:
    (tmp_path / "out.layout.json").write_text("mine")
    with pytest.raises(AlreadyExists, match="exists already"):
        export_to("foxglove", real_log(), tmp_path / "out.mcap", LOOKS)
    assert (tmp_path / "out.layout.json").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["out.layout.json"]
    with pytest.raises(AlreadyExists, match="never replaced"):
        export_to("foxglove", real_log(), tmp_path / "out.mcap", LOOKS, force=True)
    (tmp_path / "out.layout.json").write_text('{"configById": {}}')
    with pytest.raises(AlreadyExists, match="--force"):
        export_to("foxglove", real_log(), tmp_path / "out.mcap", LOOKS)
    export_to("foxglove", real_log(), tmp_path / "out.mcap", LOOKS, force=True)
    assert json.loads((tmp_path / "out.layout.json").read_text())["layout"]


@pytest.mark.parametrize("format", ["foxglove", "rerun", "lerobot", "video"])
def test_only_an_earlier_export_is_replaced(tmp_path: Path, format: Any) -> None:
    log, other = tmp_path / "log.mcap", tmp_path / "other.mcap"
    write(log, records_of(game(1, 3)))
    write(other, records_of(game(2, 3)))
    (tmp_path / "link.mcap").symlink_to(log)
    (tmp_path / "text").write_text("a thesis")
    before = log.read_bytes(), other.read_bytes()
    for target in (log, tmp_path / "link.mcap"):
        with pytest.raises(ExportError, match="is the log itself"):
            export_to(format, log, target, LOOKS, force=True)
    for target in (other, tmp_path / "text"):
        with pytest.raises(AlreadyExists, match="never replaced"):
            export_to(format, log, target, LOOKS, force=True)
    assert (log.read_bytes(), other.read_bytes(), (tmp_path / "text").read_text()) == (*before, "a thesis")
    export_to(format, log, tmp_path / "out", LOOKS)
    export_to(format, log, tmp_path / "out", LOOKS, force=True)


def test_a_data_set_of_somebody_else_is_never_replaced(tmp_path: Path) -> None:
    info = tmp_path / "set" / "meta" / "info.json"
    info.parent.mkdir(parents=True)
    info.write_text('{"codebase_version": "v3.0", "robot_type": "so100"}')
    with pytest.raises(AlreadyExists, match="never replaced"):
        export_to("lerobot", real_log(), tmp_path / "set", LOOKS, force=True)
    assert "so100" in info.read_text()


@pytest.mark.parametrize("limit", [100_000, 2_000_000])
@pytest.mark.parametrize("format", ["foxglove", "rerun", "lerobot", "video"])
def test_a_full_disk_is_one_line_that_names_the_target(tmp_path: Path, format: str, limit: int) -> None:
    """A limit of the file size stands for the full disk: the system refuses to write in the same place."""
    if format == "video":
        limit //= 20  # a video of this game is not as large
    words = [VANTAGE, "log", "export", real_log(3, 60), "--as", format, "--to", tmp_path / "out", "--game", "2"]
    if format == "lerobot":
        words.append("--without-catching")

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    done = subprocess.run(words, capture_output=True, text=True, preexec_fn=limited, timeout=60)
    assert done.returncode == 1, done.stdout
    assert done.stderr.strip().splitlines()[-1] == f"vantage log export: {tmp_path / 'out'}: File too large"
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_full_but_for_a_little_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What closing writes may fit where a whole chunk did not: the copy is short all the same."""
    write_chunk, calls = Part.write_chunk, 0

    def once_full(self: Part, group: str) -> bool:
        nonlocal calls
        calls += 1
        if calls == 1:
            raise ChunkLost(OSError(errno.ENOSPC, "No space left on device"), {("hider/color", "simulator"): 1})
        return write_chunk(self, group)

    monkeypatch.setattr(Part, "write_chunk", once_full)
    with pytest.raises(OSError, match=f"No space left on device: '{tmp_path / 'out.mcap'}'"):
        export_to("foxglove", real_log(), tmp_path / "out.mcap", LOOKS)
    assert list(tmp_path.iterdir()) == []


def test_copies_and_what_is_being_written_are_no_logs(tmp_path: Path) -> None:
    write(tmp_path / "run.mcap", records_of(game(1, 3)))
    export_to("foxglove", tmp_path / "run.mcap", None, LOOKS)
    (tmp_path / ".run.partial-1.mcap").write_bytes((tmp_path / "run.mcap").read_bytes())
    (tmp_path / ".trash").mkdir()
    (tmp_path / ".trash" / "old.mcap").write_bytes((tmp_path / "run.mcap").read_bytes())
    assert find_logs(tmp_path) == [[tmp_path / "run.mcap"]]
    assert parts_of(tmp_path) == [tmp_path / "run.mcap"]
    copy = tmp_path / "run-viewer.mcap"
    assert [record.payload for record in read(copy)] == [record.payload for record in read(tmp_path / "run.mcap")]
    export_to("video", copy, None, LOOKS)


def test_the_persons_name_stays_in_the_log(tmp_path: Path) -> None:
    records = list(read(real_log()))
    wish = Control(stamp=1, action="start", players=Players(hider="human", person=PERSON))
    first = records[0]
    records.insert(0, Record("control", "console", 0, first.log_time - 2, 0, encode(wish)))
    records.insert(1, Record("episode", "referee", 0, first.log_time - 1, 0, f"not msgpack {PERSON}".encode(), False))
    with LogWriter(tmp_path / "log.mcap", {}, sync=False, compression="none") as writer:
        for record in records:
            write_record(writer, record)
    assert PERSON.encode() in (tmp_path / "log.mcap").read_bytes()
    export_to("foxglove", tmp_path / "log.mcap", None, LOOKS)
    copied = list(read(tmp_path / "log-viewer.mcap", viewer=True))
    assert not [record.key for record in copied if PERSON.encode() in record.payload]
    blanked = [record.decode() for record in copied if record.key in ("episode", "control")]
    originals = [record.decode() for record in records if record.key in ("episode", "control") and record.well_formed]
    assert blanked == [structs.replace(said, players=structs.replace(said.players, person="")) for said in originals]


@pytest.mark.parametrize("at_once", [True, False])
def test_a_copy_of_a_discarded_game_says_so(tmp_path: Path, at_once: bool) -> None:
    first, second = records_of(game(1, 3)), records_of(game(2, 3), start=START + 10**9)
    write(tmp_path / "log.mcap", [*first, discard(1, first[-1 if at_once else -3]), *second, discard(1, second[-1])])
    done = export_to("foxglove", tmp_path / "log.mcap", tmp_path / "one.mcap", LOOKS, episode=1)
    assert "game 1, discarded" in done.said[0]
    with open_log(tmp_path / "one.mcap") as log:
        assert [(found.number, found.discarded) for found in games_of(log)] == [(1, True)]
    for format in ("rerun", "video"):
        done = export_to(format, tmp_path / "log.mcap", tmp_path / format, LOOKS, episode=1)  # type: ignore[arg-type]
        assert "game 1, discarded" in done.said[0]
        done = export_to(format, tmp_path / "log.mcap", tmp_path / f"{format}-2", LOOKS, episode=2)  # type: ignore[arg-type]
        assert re.search("game 2, [34] steps", done.said[0])


def test_one_argument_means_one_log(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "run.mcap", {}, sync=False, split_bytes=4000, chunk_size=1000) as writer:
        for record in records_of(game(1, 30)):
            write_record(writer, record)
    first, second = sorted(tmp_path.glob("run_*.mcap"))[:2]
    export_to("foxglove", first, tmp_path / "out.mcap", LOOKS)
    assert len(list(read(tmp_path / "out.mcap"))) == len(records_of(game(1, 30)))
    with pytest.raises(NoSuchLog, match="is part 2 of a log"):
        export_to("foxglove", second, None, LOOKS)


def test_what_is_no_log_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "text.mcap").write_text("no log at all, but some text")
    write(tmp_path / "empty.mcap", [])
    for name, why in (("text.mcap", "not an MCAP file"), ("empty.mcap", "it holds none")):
        for format in ("foxglove", "rerun", "lerobot", "video"):
            with pytest.raises(ExportError, match=f"{name}: no message can be read from it: .*{why}"):
                export_to(format, tmp_path / name, tmp_path / "out", LOOKS)  # type: ignore[arg-type]
    assert not (tmp_path / "out").exists()
    (tmp_path / "folder").mkdir()
    write(tmp_path / "folder" / "run.mcap", records_of(game(1, 3)))
    monkeypatch.chdir(tmp_path / "folder")
    for name in (".", "../folder"):
        export_to("foxglove", Path(name), None, LOOKS, force=True)
    assert (tmp_path / "folder-viewer.mcap").exists()


def test_a_folder_of_somebody_else_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("mine")
    with pytest.raises(AlreadyExists, match="never replaced"):
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
    command = [VANTAGE, "log", "export", real_log(3, 250), "--as", format, "--to", target]
    if format in ("rerun", "video"):
        command += ["--game", "2"]
    if format == "lerobot":
        command.append("--without-catching")
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
        words = [VANTAGE, "log", "export", cut, "--as", format, "--to", tmp_path / format, "--without-catching"]
        done = subprocess.run(words, capture_output=True, text=True)
        assert done.returncode == 2, done.stderr
        assert "breaks off" in done.stderr
        assert (tmp_path / format).exists()


def test_a_missing_package_is_one_line(tmp_path: Path) -> None:
    """As on a machine without the extra `viewers`."""
    without = "import sys; sys.modules.update({'rerun': None, 'pyarrow': None, 'av': None}); from vantage.cli import main; main()"
    for format, package in (("rerun", "rerun-sdk"), ("lerobot", "pyarrow"), ("video", "av")):
        words = [sys.executable, "-c", without, "log", "export", real_log(), "--as", format, "--to", tmp_path / "out"]
        done = subprocess.run(words, capture_output=True, text=True)
        assert done.returncode == 1
        assert done.stderr.count("\n") == 1
        assert f"{package} is not installed" in done.stderr and "[viewers]" in done.stderr
