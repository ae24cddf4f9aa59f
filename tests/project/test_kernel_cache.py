"""The cache of compiled kernels never ends a program: a home that cannot be written, a file cut off, a full disk."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import numpy as np
from vantage.compiled import kernel, cache_folder
@kernel
def triple(x):
    return 3 * x
if __name__ == '__main__':
    print(triple(14), triple.stats.cache_hits and 'cached' or 'compiled', cache_folder())
"""


def run(folder: Path, **environment: str) -> "subprocess.CompletedProcess[str]":
    (folder / "program.py").write_text(PROGRAM)
    os.utime(folder / "program.py", (1, 1))  # numba compares the time of the source
    everything = {"PATH": os.environ["PATH"], "PYTHONPATH": os.pathsep.join(sys.path), **environment}
    return subprocess.run(
        [sys.executable, "program.py"], cwd=folder, env=everything, capture_output=True, text=True, check=False, timeout=240
    )


def answer(folder: Path, **environment: str) -> str:
    outcome = run(folder, **environment)
    assert outcome.returncode == 0, outcome.stderr
    return outcome.stdout.split()[1]


def test_the_folder_that_the_user_chose_is_used(tmp_path: Path) -> None:
    assert answer(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "mine")) == "compiled"
    assert list((tmp_path / "mine").rglob("*.nbi"))
    assert answer(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "mine")) == "cached"


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("length", [0, 20])
def test_a_file_that_was_cut_off_is_made_again(tmp_path: Path, ending: str, length: int) -> None:
    mine = {"NUMBA_CACHE_DIR": str(tmp_path / "mine")}
    answer(tmp_path, **mine)
    (file,) = (tmp_path / "mine").rglob(f"*.{ending}")
    file.write_bytes(file.read_bytes()[:length])
    assert answer(tmp_path, **mine) == "compiled"
    assert answer(tmp_path, **mine) == "cached"


def test_without_a_home_that_can_be_written_another_place_is_found(tmp_path: Path) -> None:
    (tmp_path / "home").write_text("a file, which not even root can write into")
    outcome = run(tmp_path, HOME=str(tmp_path / "home"))
    assert outcome.returncode == 0, outcome.stderr
    assert outcome.stdout.split()[2].startswith(f"/tmp/vantage-kernels-{os.getuid()}/")


def test_a_place_that_others_can_write_to_is_refused(tmp_path: Path) -> None:
    from vantage.compiled import cache_folder

    (tmp_path / "home/.cache/vantage/kernels").mkdir(parents=True)
    (tmp_path / "home/.cache/vantage/kernels").chmod(0o777)
    found = cache_folder({"HOME": str(tmp_path / "home")}, temporary=tmp_path)
    assert found is not None and found.parent == tmp_path / f"vantage-kernels-{os.getuid()}"
    found.parent.chmod(0o777)
    assert cache_folder({"HOME": str(tmp_path / "home")}, temporary=tmp_path) is None


def test_a_cache_that_cannot_be_written_costs_time_only(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("")
    outcome = run(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "mine"))
    assert outcome.returncode == 0, outcome.stderr
    assert outcome.stdout.startswith("42 compiled")
