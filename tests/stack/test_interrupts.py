"""Ctrl-C at a random moment of some quick commands; `python -m tests.stack.interrupts` interrupts all long ones."""

from __future__ import annotations

from tests.stack.interrupts import CASES, Settings, interrupt, table
from tests.stack.table import PATIENCE

QUICK = ("log export", "log recover")


def test_an_interrupted_command_says_one_line_leaves_nothing_half_and_completes_afterwards() -> None:
    cases = {case.name: case for case in CASES if case.name in QUICK}
    rows = interrupt(Settings(moments=1, seed=4, within=PATIENCE), list(cases.values()))
    assert len(rows) == len(QUICK)
    assert not any(row.violations for row in rows), table(rows)
