"""The name of a person who plays is the text of a stranger: in the terminal it is text, and exports do not hold it."""

from __future__ import annotations

import unicodedata
from pathlib import Path

import pytest
from msgspec.structs import replace
from rich.console import Console

from schemas import Control, Episode, Message, Players
from services.console import requests, wishes
from services.recorder.appearance import arena_appearance
from tests.log.exporting import write
from tests.log.making import game, records_of
from vantage.log import open_log
from vantage.log.export_formats import export_to
from vantage.log.report import info

NAMES = {
    "markup": "[red]Ada[/red] [/x] [link=file:///etc/passwd]",
    "direction": "\u202eadA\u202c \u2067Ada\u2069",
    "control": "\x1b[31mAda\x1b[0m\x07\x1b]0;title\x07\r\nAda",
    "long": "Ada" * 21,
}


def with_name(name: str) -> list[tuple[str, Message]]:
    return [
        (key, replace(message, players=Players(hider="human", person=name)) if isinstance(message, Episode) else message)
        for key, message in game(1, 3)
    ]


@pytest.mark.parametrize("kind", sorted(NAMES))
def test_in_the_terminal_a_name_is_text(tmp_path: Path, kind: str) -> None:
    write(tmp_path / "log.mcap", records_of(with_name(NAMES[kind])))
    console = Console(width=200, force_terminal=True, color_system=None)
    with console.capture() as capture:
        for found in info(tmp_path / "log.mcap"):
            console.print(found)
    shown = capture.get()
    assert not {letter for letter in shown if letter != "\n" and unicodedata.category(letter) in ("Cc", "Cf")}
    assert "Ada" in shown
    if kind == "markup":
        assert NAMES[kind] in shown, "word for word"


@pytest.mark.parametrize("kind", sorted(NAMES))
def test_exports_do_not_hold_it(tmp_path: Path, kind: str) -> None:
    write(tmp_path / "log.mcap", records_of(with_name(NAMES[kind])))
    export_to("foxglove", tmp_path / "log.mcap", tmp_path / "shown.mcap", arena_appearance())
    with open_log(tmp_path / "shown.mcap") as log:
        names = [message.players.person for record in log.records() if isinstance(message := record.decode(), Control | Episode)]
    assert names and set(names) == {""}


@pytest.mark.parametrize("kind", sorted(NAMES))
def test_the_console_passes_on_a_printable_line(kind: str) -> None:
    person = wishes.start(requests.Start(hider="human", person=NAMES[kind]), 1).players.person
    assert "Ada" in person or kind == "direction"
    assert person.isprintable() and person == person.strip()


def test_an_endless_name_is_refused_at_the_door() -> None:
    with pytest.raises(requests.MalformedRequest):
        requests.decode_request('{"type": "start", "hider": "human", "person": "' + "x" * 3000 + '"}')
