"""The `vantage` command: quick, complete, and clear when something is wrong."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest
import tyro

from services.seeker.policy import PRESETS
from vantage import cli
from vantage.match import SeekerPreset

VANTAGE = Path(sys.executable).parent / "vantage"


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([VANTAGE, *words], capture_output=True, text=True, check=False)


def test_help_names_every_command_and_loads_nothing_slow() -> None:
    """How long it takes is measured by benchmarks/start_up.py; here, what would make it slow."""
    outcome = run("--help")
    assert outcome.returncode == 0
    for command in cli.COMMANDS:
        assert command.words in outcome.stdout
    program = "import sys, vantage.cli; vantage.cli.overview(); print(*{name.partition('.')[0] for name in sys.modules})"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    assert not {"torch", "numba", "numpy", "zenoh", "tyro", "rich", "supervisor", "msgspec"} & set(loaded)


@pytest.mark.parametrize("command", cli.COMMANDS, ids=lambda command: command.words)
def test_every_command_exists_and_explains_itself(command: cli.Command, capsys: pytest.CaptureFixture[str]) -> None:
    # In this process: two dozen processes that load torch take a minute.
    with pytest.raises(SystemExit) as ended:
        cli.run(command, ("--help",))
    shown = capsys.readouterr().out
    assert ended.value.code == 0
    assert f"usage: vantage {command.words}" in shown
    assert f"vantage {command.words}" in shown.partition("\n")[2], "the help shows no example"


@pytest.mark.parametrize("command", cli.COMMANDS, ids=lambda command: command.words)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_every_option_has_a_help_text(command: cli.Command) -> None:
    _, kind = cli.settings_of(command)
    options = [action for action in tyro.extras.get_parser(kind)._actions if action.dest != "help"]
    bare = [action.dest for action in options if re.fullmatch(r"\s*(\([^)]*\)\s*)*", action.help or "")]
    assert not bare, "these options say only their default"


def test_help_of_a_command_is_printed_by_the_script_too() -> None:
    outcome = run("log", "export", "--help")
    assert outcome.returncode == 0, outcome.stderr
    assert "usage: vantage log export" in outcome.stdout


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("fly",), "no command `fly`"),
        (("train",), "vantage train vpt-tob"),
        (("up", "moon"), "no deployment `moon`; there is: hardware, rehearsal, replay, simulation"),
        (("up", "--with", "seeker"), 'NAME="ARGUMENTS"'),
        (("up", "--with", "pilot=--x"), "no such service in this deployment: pilot"),
        (("up", "--folder", "/tmp/" + "long" * 30), "too long for unix sockets"),
        (("status", "--folder", "/tmp/vantage-nobody-is-here"), "vantage up simulation"),
        (("logs", "pilot"), "no service `pilot`"),
        (("play", "--folder", "/tmp/vantage-nobody-is-here"), "vantage up simulation"),
        (("play", "--steps", "0"), "--steps must be 1 to 100000, not 0"),
        (("play", "--games", "0"), "--games must be 1 to 1000000, not 0"),
        (("play", "--games", "-1"), "--games must be 1 to 1000000, not -1"),
        (("play", "--period", "nan"), "--period must be 0 to 3600, not nan"),
        (("play", "--seed", "-1"), "--seed must be 0 to"),
        (("stop", "--folder", "/tmp/vantage-nobody-is-here"), "vantage up simulation"),
        (("play", "--layout", "nowhere.json"), "no layout 'nowhere.json'"),
        (("play", "--seeker", "blind"), "glancing"),
        (("demo", "--period", "-1"), "--period must be 0 to 3600, not -1"),
    ],
)
def test_mistakes_are_answered_in_one_readable_text(words: tuple[str, ...], told: str) -> None:
    outcome = run(*words)
    assert outcome.returncode in (1, 2)
    assert told in outcome.stderr
    assert "Traceback" not in outcome.stderr


def test_the_seekers_that_people_may_ask_for_are_the_presets_there_are() -> None:
    assert set(get_args(SeekerPreset)) == set(PRESETS)


def test_down_is_content_when_nothing_is_up() -> None:
    outcome = run("down", "--folder", "/tmp/vantage-nobody-is-here")
    assert outcome.returncode == 0
    assert "was not up" in outcome.stdout
