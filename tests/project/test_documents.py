"""What the documents say must be so."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from vantage import cli, drawing

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    *("README.md", "docs/architecture.md", "docs/method.md", "docs/console.md", "docs/table.md", "docs/robot-protocol.md"),
    "compose/README.md",
)


def test_the_committed_drawing_is_up_to_date() -> None:
    assert (ROOT / "docs/processes.svg").read_text() == drawing.svg(drawing.declarations()), "run python -m vantage.drawing"


def test_the_committed_topic_table_is_up_to_date() -> None:
    text = (ROOT / "docs/architecture.md").read_text()
    assert text == drawing.with_tables(text, drawing.declarations()), "run python -m vantage.drawing"


@pytest.mark.parametrize("page", PAGES)
def test_every_command_in_a_page_exists(page: str) -> None:
    text = (ROOT / page).read_text()
    quoted = re.findall(r"`(vantage [a-z][^`]*)`", text) + re.findall(r"^ *(vantage [a-z].*)$", text, re.MULTILINE)
    for command in quoted:
        assert cli.find(command.split()[1:]) is not None, f"{page} names `{command}`"
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for target in re.findall(r"`make ([a-z]+)`", text):
        assert target in targets, f"{page} names `make {target}`"


@pytest.mark.parametrize("page", PAGES)
def test_every_link_to_a_file_leads_somewhere(page: str) -> None:
    path = ROOT / page
    for target in re.findall(r"\]\(([^)#]+)\)", path.read_text()):
        if not target.startswith(("http:", "https:")):
            assert (path.parent / target).exists(), f"{page} links {target}"


@pytest.mark.parametrize("page", PAGES)
def test_every_file_named_in_a_page_exists(page: str) -> None:
    named = re.findall(
        r"`((?:vantage|services|schemas|learning|compose|tests|docs|weights|benchmarks)/[\w/.-]+)`", (ROOT / page).read_text()
    )
    for name in named:
        if not name.startswith("services/closeness"):  # the example
            assert (ROOT / name).exists(), f"{page} names {name}"


def test_readme_shows_the_two_commands_and_names_every_command() -> None:
    text = (ROOT / "README.md").read_text()
    assert "make demo" in text
    assert "make test" in text
    for command in cli.COMMANDS:
        assert f"vantage {command.words.split()[0]}" in text, command.words
