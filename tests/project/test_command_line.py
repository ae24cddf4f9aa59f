"""The `vantage` command: quick, complete, and clear when something is wrong."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from services.seeker.policy import PRESETS
from vantage import cli
from vantage.match import SeekerPreset

VANTAGE = Path(sys.executable).parent / "vantage"


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([VANTAGE, *words], capture_output=True, text=True, check=False)


def test_help_is_quick_and_names_every_command() -> None:
    """Computing time, so that a busy machine does not matter."""
    durations = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        outcome = run("--help")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        durations.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    assert min(durations) < 0.3
    assert outcome.returncode == 0
    for command in cli.COMMANDS:
        assert command.words in outcome.stdout


@pytest.mark.parametrize("command", cli.COMMANDS, ids=lambda command: command.words)
def test_every_command_exists_and_explains_itself(command: cli.Command, capsys: pytest.CaptureFixture[str]) -> None:
    # In this process: two dozen processes that load torch take a minute.
    with pytest.raises(SystemExit) as ended:
        cli.run(command, ("--help",))
    shown = capsys.readouterr().out
    assert ended.value.code == 0
    assert f"usage: vantage {command.words}" in shown
    assert f"vantage {command.words}" in shown.partition("\n")[2], "the help shows no example"


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
