"""Errors of people and of the operating system become one line; bugs keep their traceback."""

import errno
import subprocess
import sys
from pathlib import Path

import pytest

from vantage.errors import UserError, explain


def test_a_full_disk_is_named_with_its_file_and_a_remedy() -> None:
    line = explain(OSError(errno.ENOSPC, "No space left on device", "logs/a.mcap"))
    assert line == "logs/a.mcap: No space left on device; free some space, then run it again"


def test_an_error_without_a_file_is_explained_too() -> None:
    assert explain(OSError(errno.EROFS, "Read-only file system")).startswith("Read-only file system; ")  # type: ignore[union-attr]


@pytest.mark.parametrize("bug", [KeyError("x"), ValueError("x"), RuntimeError("x"), OSError("without a number")])
def test_a_bug_is_not_explained(bug: Exception) -> None:
    assert explain(bug) is None


def test_every_error_for_people_is_found_by_its_class() -> None:
    root = Path(__file__).resolve().parents[2]
    sources = [path for room in ("vantage", "services", "learning") for path in (root / room).rglob("*.py")]
    assert not [path for path in sources if "for_people =" in path.read_text()]
    assert explain(UserError("what is wrong: what to do")) == "what is wrong: what to do"


def run(*arguments: str, **options: object) -> "subprocess.CompletedProcess[str]":
    command = [str(Path(sys.executable).parent / "vantage"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120, **options)  # type: ignore[call-overload,no-any-return]


def test_a_path_through_a_file_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    outcome = run("table", "print", "--to", str(tmp_path / "file" / "prints"))
    assert outcome.returncode == 1
    assert outcome.stderr.count("\n") == 1 and "Not a directory" in outcome.stderr


def test_a_name_with_codes_is_printed_and_not_obeyed(tmp_path: Path) -> None:
    outcome = run("log", "info", str(tmp_path / "a\x1b[31mb.mcap"))
    assert outcome.returncode == 1 and "\x1b" not in outcome.stderr and "a[31mb.mcap" in outcome.stderr


def test_a_terminal_that_lacks_letters_ends_no_command(tmp_path: Path) -> None:
    outcome = run("log", "info", str(tmp_path / "Spiel-Ω.mcap"), env={"PYTHONIOENCODING": "ascii", "PATH": "/usr/bin:/bin"})
    assert outcome.returncode == 1 and "UnicodeEncodeError" not in outcome.stderr


def test_a_reader_that_goes_away_ends_a_command_quietly() -> None:
    vantage = Path(sys.executable).parent / "vantage"
    outcome = subprocess.run(["sh", "-c", f"{vantage} check | true"], capture_output=True, text=True, check=False, timeout=120)
    assert outcome.stderr == ""


def test_the_version_is_known() -> None:
    outcome = run("--version")
    assert outcome.returncode == 0 and outcome.stdout.startswith("vantage 0.")
