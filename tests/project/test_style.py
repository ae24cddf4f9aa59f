"""ruff and mypy as part of the suite."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ("schemas", "vantage", "services", "learning", "tests", "benchmarks", "docs")


@pytest.mark.parametrize(
    "command", [("ruff", "check", *SOURCES), ("ruff", "format", "--check", *SOURCES), ("mypy",)], ids=["lint", "format", "types"]
)
def test_clean(command: tuple[str, ...]) -> None:
    tool = Path(sys.executable).parent / command[0]
    outcome = subprocess.run([tool, *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, (outcome.stdout + outcome.stderr)[-6000:]


@pytest.mark.parametrize("room", ["schemas", "vantage", "services", "learning"])
def test_files_stay_readable(room: str) -> None:
    long = {
        str(path.relative_to(ROOT)): count
        for path in (ROOT / room).rglob("*.py")
        if (count := len(path.read_text().splitlines())) > 400
    }
    assert not long, f"more than 400 lines: {long}"
