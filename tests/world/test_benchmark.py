"""The benchmark of the game step runs, and its plain implementation sees what the kernels see."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

_SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "game_step.py"


def test_the_benchmark_runs_and_its_two_implementations_agree() -> None:
    command = [sys.executable, str(_SCRIPT), "--steps", "300", "--repetitions", "1", "--plain-steps", "20"]
    output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=100).stdout
    difference = re.search(r"differs by (\S+) m at most", output)
    assert difference is not None
    assert float(difference[1]) < 1e-9
    assert "compiled, both state images" in output
