"""A rehearsed table on a machine whose cores are busy: games slow down, and end; nobody is called silent who was not."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from schemas import Episode, Motion
from tests.stack.table import Table
from vantage.cores import available_cores
from vantage.log import find_logs, open_log

SEED = 2250
STEPS = 6


@contextmanager
def busy_loops(count: int) -> Iterator[None]:
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def test_beside_busy_loops_a_rehearsed_game_is_played_to_its_end() -> None:
    with Table("rehearsal", "--with", f"rehearsal=--layout-seed {SEED}") as table:
        assert table.started.returncode == 0, table.started.stderr
        with busy_loops(2 * available_cores()):
            outcome = table.command("play", "--seed", str(SEED), "--steps", str(STEPS), "--deployment", "rehearsal")
        assert outcome.returncode == 0, outcome.stdout + outcome.stderr
        said = []
        for parts in find_logs(table.logs):
            with open_log(*parts) as log:
                said += [record.decode() for record in log.records()]
    assert not [message.reason for message in said if isinstance(message, Episode) and message.phase == "aborted"]
    motions = [message for message in said if isinstance(message, Motion)]
    assert motions and {motion.result for motion in motions} <= {"completed", "refused", "stuck", "timed-out"}
