"""A command that is asked to stop ends within two seconds, with one line, whatever it is doing."""

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

BUSY = {
    "python": "import time\nwhile True: time.sleep(0.01)",
    "kernel": """
import numba
@numba.njit(nogil=True)
def forever():
    n = 0
    while n >= 0:
        n = (n + 1) % 1000003
    return n
print('compiled', flush=True)
forever()""",
    "pool": """
import time
from concurrent.futures import ThreadPoolExecutor
with ThreadPoolExecutor(2) as pool:
    list(pool.map(time.sleep, [60] * 8))""",
    "cleaning up": "import time\ntry:\n    time.sleep(60)\nfinally:\n    time.sleep(60)",
    "checked": """
import time
from vantage.stopping import stop_deferred, stop_requested
with stop_deferred():
    while not stop_requested(): time.sleep(0.01)
raise KeyboardInterrupt""",
}


def start(body: str) -> "subprocess.Popen[str]":
    indented = "\n".join(f"    {line}" for line in body.splitlines())
    program = f"""
import sys
from vantage.stopping import run_stoppable
def command():
    print('running', flush=True)
{indented}
    return 0
sys.exit(run_stoppable(command, 'vantage test', 'all is kept'))
"""
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "running\n"
    if "compiled" in body:
        assert process.stdout.readline() == "compiled\n"
    return process


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("doing", BUSY)
def test_it_ends_with_one_line(doing: str, number: signal.Signals) -> None:
    process = start(BUSY[doing])
    time.sleep(0.2)  # into what it does
    process.send_signal(number)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    assert errors == "vantage test: stopped; all is kept\n"


def test_a_command_under_nohup_outlives_its_terminal() -> None:
    body = "import os\nos.kill(os.getpid(), 1)\nprint('alive', flush=True)"
    indented = "\n".join(f"    {line}" for line in body.splitlines())
    program = f"from vantage.stopping import run_stoppable\ndef command():\n{indented}\n    return 0\nrun_stoppable(command, 'x')"
    outcome = subprocess.run(["nohup", sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
    assert outcome.stdout == "alive\n", outcome.stderr


def test_a_worker_ends_with_its_parent_and_leaves_ctrl_c_to_it() -> None:
    worker = (
        "import time\nfrom vantage.stopping import follow_parent\nfollow_parent()\nprint('ready', flush=True)\ntime.sleep(60)"
    )
    program = f"""
import subprocess, sys, time
child = subprocess.Popen([sys.executable, '-c', {worker!r}], stdout=subprocess.PIPE, text=True)
child.stdout.readline()
print(child.pid, flush=True)
time.sleep(60)"""
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    os.kill(child, signal.SIGINT)
    os.kill(child, signal.SIGHUP)
    assert psutil.Process(child).status() != psutil.STATUS_ZOMBIE
    parent.kill()
    parent.wait()
    deadline = time.monotonic() + 20
    while psutil.pid_exists(child) and psutil.Process(child).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < deadline
        time.sleep(0.01)
