"""Wishes, keys, the line shown, and mistakes at the command line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from schemas import Control, Playback
from tests.replay.games import MILLISECOND, ListedSource, game, recorded
from tests.replay.test_recording import made, write
from vantage.replay.display import clock_text, line
from vantage.replay.keys import wishes_in
from vantage.replay.playback import SECOND, SETTLE
from vantage.replay.playback import Playback as Core
from vantage.replay.playing import Quit, obey

VANTAGE = Path(sys.executable).parent / "vantage"


def core() -> Core:
    said = game(1, 5, 6, "ended") + game(2, 6, 6, "ended")
    playback = Core(ListedSource(recorded(said, [100 * MILLISECOND])), lambda key, publisher: True, 0)
    playback.turn(0)
    return playback


def test_keys_mean_what_the_help_says() -> None:
    assert wishes_in("\x1b[D \x1b[Cx\x1b[A\x1b[BnPq\x1b[Z\x1bOD") == [
        *("back", "pause", "forward", "faster", "slower", "next", "previous", "quit", "back"),
    ]


def test_wishes_move_the_playback() -> None:
    playback, now = core(), SETTLE
    obey(playback, Control(stamp=1, action="pause"), now)
    assert playback.state == "paused"
    obey(playback, Control(stamp=1, action="pause"), now)
    assert playback.state == "paused"
    obey(playback, Control(stamp=1, action="resume", speed=4.0), now)
    assert (playback.state, playback.speed) == ("playing", 4.0)
    obey(playback, "pause", now)
    assert playback.state == "paused"
    obey(playback, "pause", now)
    assert playback.state == "playing"
    obey(playback, "faster", now)
    assert playback.speed == 8.0
    for _ in range(20):
        obey(playback, "slower", now)
    assert playback.speed == 0.1
    obey(playback, Control(stamp=1, action="seek", position=1.5), now)
    assert playback.report(now).position == 1.5
    obey(playback, "back", now)
    assert playback.report(now).position == 0.0
    obey(playback, "next", now)
    assert playback.report(now).episode == 2
    obey(playback, "next", now)
    assert playback.report(now).episode == 2
    obey(playback, "previous", now)
    assert playback.report(now).episode == 1
    with pytest.raises(ValueError, match="nobody plays games in a replay"):
        obey(playback, Control(stamp=1, action="start"), now)
    with pytest.raises(Quit):
        obey(playback, "quit", now)


def test_after_the_end_space_begins_again() -> None:
    playback = core()
    for now in range(0, 20 * SECOND, SECOND // 10):
        playback.turn(now)
    assert playback.state == "ended"
    obey(playback, "pause", now)
    assert playback.state == "playing" and playback.position(now) == playback.report(now).stamp
    assert playback.report(now).position == 0.0 and playback.jumps == 1


def test_the_line_says_where_it_stands() -> None:
    report = Playback(stamp=1, episode=7, step=12, log="x", position=75.25, duration=3700.0, speed=2.0, state="paused")
    assert line(report, 3, 5) == "⏸ 1:15.2 / 1:01:40.0  game 7 (4 of 5)  step 12  x2  paused"
    assert "no game yet" in line(report, None, 5) and "no game in it" in line(report, None, 0)
    assert clock_text(59.99) == "0:59.9"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("nowhere.mcap",), "no such log or folder"),
        (("run.mcap", "--game", "7"), "has no game 7; there is: 1, 2, 3"),
        (("run.mcap", "--from", "1e6"), "s long"),
        (("run.mcap", "--speed", "1000"), "0.1 to 100"),
        (("run.mcap", "--without", "referee"), "a live one would play its own"),
        (("run.mcap", "--from", "1", "--game", "1"), "give one"),
        (("text.mcap",), "nothing to replay"),
    ],
)
def test_mistakes_are_answered_in_one_readable_text(tmp_path: Path, words: tuple[str, ...], told: str) -> None:
    write(tmp_path / "run.mcap", made())
    (tmp_path / "text.mcap").write_text("some text")
    outcome = subprocess.run([VANTAGE, "replay", *words], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert outcome.returncode == 1
    assert outcome.stderr.startswith("vantage replay: ") and told in outcome.stderr
    assert "Traceback" not in outcome.stderr
