"""The readers that are there check our exports; for the others it is said how they come."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.log.exporting import real_log
from tests.log.readers import programs

MISSING = f"not installed: `{programs.INSTALL}` installs it and runs all readers"


def check(check: Callable[[Path, Path], str], folder: Path) -> None:
    assert check(real_log(), folder)


@pytest.mark.skipif(not programs.has_node(), reason=MISSING)
def test_the_official_typescript_library_reads_the_copy(tmp_path: Path) -> None:
    check(programs.check_node, tmp_path)


def test_rerun_reads_the_copy(tmp_path: Path) -> None:
    check(programs.check_rerun_mcap, tmp_path)


@pytest.mark.skipif(not programs.has_lerobot(), reason=MISSING)
def test_lerobot_loads_the_data_set(tmp_path: Path) -> None:
    check(programs.check_lerobot, tmp_path)


@pytest.mark.skipif(not programs.has_ffprobe(), reason="no ffprobe: apt-get install ffmpeg")
def test_ffprobe_finds_what_browsers_play(tmp_path: Path) -> None:
    check(programs.check_ffprobe, tmp_path)
