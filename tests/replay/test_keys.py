"""The keyboard of a replay, in real terminals."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

LISTEN = """
from vantage.replay.keys import keyboard
with keyboard(print) as keys:
    print(f"keys {keys}", flush=True)
"""
SHELL = f"""
import fcntl, os, signal, subprocess, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
child = subprocess.Popen([sys.executable, "-c", {LISTEN!r}], process_group=0)
if sys.argv[1] == "front":
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    os.tcsetpgrp(0, child.pid)
_, status = os.waitpid(child.pid, os.WUNTRACED)
if os.WIFSTOPPED(status):
    print(f"stopped by {{signal.Signals(os.WSTOPSIG(status)).name}}", flush=True)
    os.kill(child.pid, signal.SIGKILL)
    os.waitpid(child.pid, 0)
"""


@pytest.mark.parametrize(("where", "said"), [("front", "keys True\n"), ("background", "keys False\n")])
def test_in_the_background_of_a_shell_it_leaves_the_terminal_alone(where: str, said: str) -> None:
    """`vantage replay LOG &`: the kernel stops who sets the terminal there."""
    leader, follower = os.openpty()
    try:
        shell = [sys.executable, "-c", SHELL, where]
        outcome = subprocess.run(
            shell, stdin=follower, capture_output=True, text=True, start_new_session=True, timeout=120, check=False
        )
        assert outcome.stdout == said, outcome.stderr
    finally:
        os.close(leader)
        os.close(follower)
