"""`vantage table` from a terminal: what it lists, and mistakes answered in one line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

VANTAGE = Path(sys.executable).parent / "vantage"


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([VANTAGE, *words], cwd=folder, capture_output=True, text=True, check=False)


def test_the_group_lists_its_commands(tmp_path: Path) -> None:
    for words in (("table",), ("table", "calibrate")):
        outcome = run(tmp_path, *words)
        assert outcome.returncode == 2
        assert "vantage table calibrate arena" in outcome.stderr
    assert run(tmp_path, "table", "--help").returncode == 0


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("check", "--source", "nowhere.png"), "there is no picture nowhere.png"),
        (("check", "--source", "."), "holds no picture"),
        (("check", "moon"), "no deployment `moon`"),
        (("calibrate", "lens", "--source", "91"), "/dev/video91 is not there"),
        (("calibrate", "arena", "--source", "91"), "cannot read the table table.json"),
        (("calibrate", "robot", "--robot", "hider", "--source", "floor.npz"), "there is no depth picture floor.npz"),
        (("colors", "--source", "91", "--grey", "1"), "--grey '1': give the place"),
        (("print", "--table", "nowhere.json"), "cannot read the table nowhere.json"),
        (("print", "--to", "/proc/none"), "vantage table print: /proc/none: "),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else None,
)
def test_mistakes_are_answered_in_one_readable_line(words: tuple[str, ...], told: str, tmp_path: Path) -> None:
    outcome = run(tmp_path, "table", *words)
    assert outcome.returncode == 1
    assert told in outcome.stderr
    assert len(outcome.stderr.strip().splitlines()) == 1
    assert "Traceback" not in outcome.stderr


@pytest.mark.parametrize("words", [("print",), ("check",), ("calibrate", "lens", "--source", "0"), ("colors", "--source", "0")])
def test_without_the_cameras_packages_it_says_what_to_install(words: tuple[str, ...], tmp_path: Path) -> None:
    arguments = ["vantage", "table", *words]
    program = f"import sys; sys.modules['cv2'] = None; sys.argv = {arguments!r}; from vantage.cli import main; main()"
    outcome = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert outcome.returncode == 1
    assert "the package cv2 is missing: pip install" in outcome.stderr
    assert "Traceback" not in outcome.stderr
