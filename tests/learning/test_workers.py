"""Work spread over processes: what a worker hears while it starts."""

import os
import subprocess
import sys
from pathlib import Path

TASK = """
import multiprocessing, os, pathlib, signal
if multiprocessing.current_process().name != "MainProcess":
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    pathlib.Path(f"blocked-{os.getpid()}").write_text(" ".join(sorted(signal.Signals(number).name for number in blocked)))

def double(number):
    return 2 * number
"""
PROGRAM = """
import task
from learning.workers import results_of

if __name__ == "__main__":
    print(sorted(results_of(task.double, range(4), 2)))
"""


def test_no_worker_hears_ctrl_c_while_it_imports(tmp_path: Path) -> None:
    """It would print a traceback. The first process that Python spawns starts its resource tracker, which unblocks signals."""
    (tmp_path / "task.py").write_text(TASK)
    (tmp_path / "program.py").write_text(PROGRAM)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path), str(Path(__file__).parents[2])))}
    command = [sys.executable, "program.py"]
    outcome = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (outcome.stdout, outcome.stderr) == ("[(0, 0), (1, 2), (2, 4), (3, 6)]\n", "")
    assert [path.read_text() for path in tmp_path.glob("blocked-*")] == ["SIGHUP SIGINT SIGTERM"] * 2
