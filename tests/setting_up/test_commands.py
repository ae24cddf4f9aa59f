"""`vantage table` as people use it: through its functions, on rendered pictures of a table whose truth is known."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.setting_up.table_scene import board_pictures, picture, true_lens, write_lab
from vantage import table_commands as commands
from vantage.deployment import DeploymentError
from vantage.rehearsal.overhead_picture import rehearsal_camera
from vantage.setting_up import settings
from vantage.setting_up.calibrating import load_lens, save_lens, today
from vantage.setting_up.pictures import read_picture, write_picture
from vantage.setting_up.trouble import TableTrouble
from vantage.tracking.calibration import load_calibration
from vantage.tracking.errors import TrackingError
from vantage.tracking.overhead_camera import OverheadCamera
from vantage.tracking.table import default_table, load_table, save_table

_NO_ROOM = (
    "import resource, signal, matplotlib.font_manager; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
    "resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))"
)
"""Stands for a full disk: no file may grow beyond 3,000 bytes."""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write_boards(count: int | None = None) -> None:
    for number, board in enumerate(board_pictures()[:count]):
        write_picture(Path(f"board/{number:02}.png"), board)


def test_from_board_and_corner_tags_to_a_calibration_that_is_true(capsys: pytest.CaptureFixture[str]) -> None:
    write_boards()
    save_table(default_table(), Path("table.json"))
    write_picture(Path("bare.png"), picture(robots=False))
    assert commands.calibrate_lens(settings.CalibrateLens(source="board")) == 0
    assert commands.calibrate_arena(settings.CalibrateArena(source="bare.png")) == 0
    said = capsys.readouterr().out
    assert "residual" in said and "px (RMS)" in said and "mm on the floor (RMS)" in said
    found = load_calibration(Path("overhead.json"), 1280, 720, today())
    assert found.arena_residual < 0.5
    true, seen = OverheadCamera(rehearsal_camera()), OverheadCamera(found)
    grid = np.array([(x, y, z) for x in (0.0, 0.4, 0.8, 1.2) for y in (0.0, 0.6, 1.2) for z in (0.0, 0.13, 0.2)])
    for height in (0.0, 0.13, 0.2):
        points = grid[grid[:, 2] == height]
        places, _ = seen.on_plane(true.project(points), height)
        assert np.linalg.norm(places - points[:, :2], axis=1).max() < 0.001, "m from where it truly is"
    for name in ("lens-views.png", "overhead-arena.png"):
        assert read_picture(Path(name)).shape == (720, 1280, 3)


def test_what_was_measured_before_is_kept_under_a_dated_name(capsys: pytest.CaptureFixture[str]) -> None:
    save_table(default_table(), Path("table.json"))
    save_lens(true_lens(), Path("lens.json"))
    write_picture(Path("bare.png"), picture(robots=False))
    Path("overhead.json").write_text("of before")
    os.utime("overhead.json", (0, 1_790_000_000))
    assert commands.calibrate_arena(settings.CalibrateArena(source="bare.png")) == 0
    (kept,) = Path().glob("overhead-2026-*.json")
    assert kept.read_text() == "of before"
    assert f"overhead.json written (the former one is kept as {kept.name})" in capsys.readouterr().out
    assert load_calibration(Path("overhead.json"), 1280, 720, today()).arena_residual < 1.0
    assert commands.calibrate_arena(settings.CalibrateArena(source="bare.png")) == 0
    assert len(list(Path().glob("overhead-*.json"))) == 2


def test_a_full_disk_is_one_line_and_leaves_the_former_calibration(here: Path) -> None:
    save_table(default_table(), Path("table.json"))
    save_lens(true_lens(), Path("lens.json"))
    write_picture(Path("bare.png"), picture(robots=False))
    for command, file in (("print", "prints/ruler.pdf"), ("calibrate arena --source bare.png", "overhead-arena.png")):
        words = f"import sys; sys.argv = ['vantage', *{('table ' + command).split()}]"
        done = subprocess.run(
            [sys.executable, "-c", f"{_NO_ROOM}; {words}; import vantage.cli; vantage.cli.main()"],
            capture_output=True,
            text=True,
            cwd=here,
        )
        assert done.returncode == 1, done
        assert done.stderr.count("\n") == 1, done.stderr
        line = done.stderr
        assert line.startswith(f"vantage table {command.split(' --')[0]}: {file}: "), line
    assert not Path("overhead.json").exists() and not Path("overhead-arena.png").exists()
    assert not [file for file in here.rglob("*") if "partial" in file.name or file.suffix == ".pdf"]


def test_too_few_views_say_how_many_and_which(capsys: pytest.CaptureFixture[str]) -> None:
    write_boards(3)
    write_picture(Path("board/zz.png"), np.full((720, 1280, 3), 90, np.uint8))
    with pytest.raises(TableTrouble, match=r"only 3 different views of the board in board, at least 8 .*upper left corner"):
        commands.calibrate_lens(settings.CalibrateLens(source="board"))
    assert "set aside: zz.png: only 0 corners" in capsys.readouterr().out
    assert not Path("lens.json").exists()
    assert Path("lens-views.png").is_file()


def test_an_empty_folder_and_no_camera_are_said() -> None:
    Path("board").mkdir()
    with pytest.raises(TableTrouble, match="board holds no picture"):
        commands.calibrate_lens(settings.CalibrateLens(source="board"))
    with pytest.raises(TableTrouble, match="/dev/video91 is not there: plug the camera in"):
        commands.calibrate_lens(settings.CalibrateLens(source="91"))
    with pytest.raises(TableTrouble, match="/dev/video91 is not there: plug the camera in"):
        commands.check(settings.Check(source="91"))


def test_a_picture_without_corner_tags_is_refused_and_shown() -> None:
    save_lens(true_lens(), Path("lens.json"))
    save_table(default_table(), Path("table.json"))
    write_picture(Path("covered.png"), picture(covered=frozenset({21})))
    with pytest.raises(TableTrouble, match=r"corner tag 21 not seen.*\(what was seen: overhead-arena.png\)"):
        commands.calibrate_arena(settings.CalibrateArena(source="covered.png"))
    assert Path("overhead-arena.png").is_file()
    assert not Path("overhead.json").exists()


def test_corner_tags_measured_wrongly_are_refused() -> None:
    table = default_table()
    wrong = (msgspec.structs.replace(table.corners[0], x=table.corners[0].x + 0.02), *table.corners[1:])
    save_table(msgspec.structs.replace(table, corners=wrong), Path("table.json"))
    save_lens(true_lens(), Path("lens.json"))
    write_picture(Path("bare.png"), picture(robots=False))
    with pytest.raises(TableTrouble, match="mm from where the table says"):
        commands.calibrate_arena(settings.CalibrateArena(source="bare.png"))


def test_a_lens_of_another_resolution_is_refused() -> None:
    save_lens(true_lens(), Path("lens.json"))
    save_table(default_table(), Path("table.json"))
    write_picture(Path("small.png"), np.ascontiguousarray(picture()[::2, ::2]))
    with pytest.raises(TableTrouble, match=r"640 x 360 pixels, but the lens lens\.json is for 1280 x 720"):
        commands.calibrate_arena(settings.CalibrateArena(source="small.png"))


def test_a_lens_that_is_none_is_refused() -> None:
    with pytest.raises(TableTrouble, match=r"cannot read the lens lens\.json.*calibrate lens --to lens\.json"):
        load_lens(Path("lens.json"))
    Path("lens.json").write_text("{}")
    with pytest.raises(TableTrouble, match="is not the file of a lens"):
        load_lens(Path("lens.json"))


def test_checking_a_good_picture_is_all_well(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_lab(here)
    assert commands.check(settings.Check(source="game.png")) == 0
    said = capsys.readouterr().out
    assert "trouble" not in said.replace("with trouble", "")
    assert "x 300 mm, y 300 mm, heading 29°" in said
    annotated = read_picture(Path("table-check/game.png"))
    assert (annotated != picture()).any(axis=2).mean() > 0.005


def test_checking_a_folder_names_the_picture_that_is_bad(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_lab(here)
    write_picture(Path("shots/a.png"), picture())
    write_picture(Path("shots/b.png"), picture(covered=frozenset({0})))
    assert commands.check(settings.Check(source="shots")) == 1
    troubles = [line for line in capsys.readouterr().out.splitlines() if line.startswith("trouble")]
    assert len(troubles) == 1
    assert "b.png: robots' tags" in troubles[0] and "missing: 0 (hider)" in troubles[0]


def test_without_a_calibration_the_check_says_what_to_do(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_lab(here)
    Path("overhead.json").unlink()
    assert commands.check(settings.Check(source="game.png")) == 1
    said = capsys.readouterr().out
    assert "there is no overhead.json" in said and "vantage table calibrate arena" in said
    assert "4 of 4 found" in said


def test_a_picture_of_another_size_than_the_calibration_is_refused(here: Path) -> None:
    write_lab(here)
    write_picture(Path("small.png"), np.ascontiguousarray(picture()[::2, ::2]))
    with pytest.raises(TableTrouble, match="640 x 360 pixels, but the calibration is for 1280 x 720"):
        commands.check(settings.Check(source="small.png"))


def test_printing_leaves_a_table_that_was_measured_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert commands.print_sheets(settings.Print()) == 0
    assert load_table(Path("prints/table.json")) == default_table()
    measured = msgspec.structs.replace(default_table(), corner_size=0.079)
    save_table(measured, Path("prints/table.json"))
    assert commands.print_sheets(settings.Print()) == 0
    assert load_table(Path("prints/table.json")) == measured
    assert "was left alone" in capsys.readouterr().out
    with pytest.raises(TrackingError, match=r"nowhere\.json"):
        commands.print_sheets(settings.Print(table=Path("nowhere.json")))


def test_a_deployment_that_is_not_up_is_said() -> None:
    with pytest.raises(DeploymentError, match="vantage up hardware"):
        commands.check(settings.Check(folder=Path("/tmp/vantage-nobody-is-here")))
