"""Results get their names when they are complete, and overwrite nothing unless asked to."""

import os
from pathlib import Path

import pytest

from vantage.output import AlreadyExists, complete, partial_name, remove_abandoned, write_complete


def test_a_failure_leaves_what_was_there(tmp_path: Path) -> None:
    target = tmp_path / "result.json"
    write_complete(target, "before")

    def fail_half_way() -> None:
        with complete(target) as partial:
            partial.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_half_way()
    assert target.read_text() == "before" and os.listdir(tmp_path) == ["result.json"]


def test_nothing_has_the_name_before_the_end(tmp_path: Path) -> None:
    target = tmp_path / "result.json"
    with complete(target) as partial:
        partial.write_text("whole")
        assert not target.exists() and partial.name.startswith(".")
    assert target.read_text() == "whole"


def test_a_folder_replaces_a_folder(tmp_path: Path) -> None:
    target = tmp_path / "set"
    for text in ("one", "two"):
        with complete(target) as partial:
            partial.mkdir()
            (partial / "a").write_text(text)
    assert (target / "a").read_text() == "two" and os.listdir(tmp_path) == ["set"]


def test_what_is_there_is_kept_unless_it_may_be_replaced(tmp_path: Path) -> None:
    target = tmp_path / "result.json"
    write_complete(target, "before")
    with pytest.raises(AlreadyExists, match=r"result\.json exists already"):
        write_complete(target, "after", replace=False)
    assert target.read_text() == "before"


def test_a_full_disk_is_told_by_the_name_of_the_result(tmp_path: Path) -> None:
    def write_to_a_full_disk() -> None:
        with complete(tmp_path / "result.json") as partial:
            partial.symlink_to("/dev/full")
            with partial.open("w") as file:
                file.write("x")

    with pytest.raises(OSError, match=r"result\.json") as caught:
        write_to_a_full_disk()
    assert caught.value.errno == 28 and os.listdir(tmp_path) == []


def test_neighbours_of_a_folder_are_left_alone(tmp_path: Path) -> None:
    other = tmp_path / f".set.partial-{os.getpid()}9"
    for path in (tmp_path / ".set-backup", tmp_path / ".set.other", other):
        path.mkdir()
    with complete(tmp_path / "set") as partial:
        partial.mkdir()
    assert sorted(os.listdir(tmp_path)) == [".set-backup", ".set.other", other.name, "set"]


def test_a_folder_that_was_moved_aside_comes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "a").write_text("good")
    rename = Path.rename

    def interrupted(path: Path, target: Path) -> Path:
        if ".partial-" in path.name:
            raise KeyboardInterrupt
        return rename(path, target)

    def replace() -> None:
        with complete(tmp_path / "set") as partial:
            partial.mkdir()

    monkeypatch.setattr(Path, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt):
        replace()
    assert (tmp_path / "set" / "a").read_text() == "good" and os.listdir(tmp_path) == ["set"]
    monkeypatch.undo()
    (tmp_path / "set").rename(tmp_path / ".set.old-4194305")  # as a process leaves it that is killed there
    remove_abandoned(tmp_path)
    assert (tmp_path / "set" / "a").read_text() == "good" and os.listdir(tmp_path) == ["set"]


def test_what_a_dead_process_left_is_removed_and_a_living_one_s_is_not(tmp_path: Path) -> None:
    dead, living = tmp_path / ".a.partial-4194305.json", partial_name(tmp_path / "b.json")
    for path in (dead, living):
        path.write_text("")
    remove_abandoned(tmp_path)
    assert os.listdir(tmp_path) == [living.name]
