"""What `vantage log info` prints of names and reasons that others made up."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from schemas import Episode, Players
from tests.golden.make_log import GOLDEN
from tests.log.making import records_of, write_log
from vantage.log.report import info


def test_a_terminal_of_80_columns_shows_every_word() -> None:
    (report,) = info(GOLDEN / "log_v3.mcap")
    printed = StringIO()
    Console(file=printed, width=80).print(report)
    assert "…" not in printed.getvalue()
    assert "malformed" in printed.getvalue()


@pytest.mark.parametrize("name", ["[/red]", "[bold]Ada", "Ada\x1b[2J\x07", "\u202eadA"])
def test_a_name_is_printed_as_it_is_and_obeyed_by_nobody(tmp_path: Path, name: str) -> None:
    episode = Episode(stamp=1, episode=1, seed=5, phase="aborted", players=Players(hider="human", person=name), reason=name)
    write_log(tmp_path / "log.mcap", records_of([("episode", episode)]))
    (report,) = info(tmp_path / "log.mcap")
    printed = StringIO()
    Console(file=printed, width=400, force_terminal=True, color_system=None).print(report)
    plain = "".join(letter for letter in name if letter.isprintable())
    assert printed.getvalue().count(plain) == 2
    assert printed.getvalue().replace("\n", "").isprintable()
