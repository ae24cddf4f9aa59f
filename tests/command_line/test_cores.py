"""The cores that a process may use: affinity and control groups, not the machine's."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from vantage.cores import _cpu_quota, available_cores


def test_affinity_counts() -> None:
    core = min(os.sched_getaffinity(0))
    program = "from vantage.cores import available_cores; print(available_cores())"
    outcome = subprocess.run(
        ["taskset", "-c", str(core), sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert outcome.stdout == "1\n"
    assert 1 <= available_cores() <= len(os.sched_getaffinity(0))


@pytest.mark.parametrize(
    ("own", "above", "quota"),
    [("max 100000", "max 100000", None), ("150000 100000", "max 100000", 1.5), ("400000 100000", "200000 100000", 2.0)],
)
def test_the_quota_is_the_smallest_of_the_groups_above(tmp_path: Path, own: str, above: str, quota: float | None) -> None:
    (tmp_path / "jobs" / "mine").mkdir(parents=True)
    (tmp_path / "jobs" / "mine" / "cpu.max").write_text(own)
    (tmp_path / "jobs" / "cpu.max").write_text(above)
    process = tmp_path / "cgroup"
    process.write_text("0::/jobs/mine\n")
    assert _cpu_quota(tmp_path, process) == quota


def test_the_quota_of_control_groups_of_the_first_kind(tmp_path: Path) -> None:
    (tmp_path / "cpu").mkdir()
    (tmp_path / "cpu" / "cpu.cfs_quota_us").write_text("250000\n")
    (tmp_path / "cpu" / "cpu.cfs_period_us").write_text("100000\n")
    assert _cpu_quota(tmp_path, tmp_path / "none") == 2.5
