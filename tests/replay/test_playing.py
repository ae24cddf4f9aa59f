"""Wishes, keys, the line shown, and mistakes at the command line."""

from __future__ import annotations

import io
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest
from rich.console import Console

from schemas import Control, Health, Message, Playback, Tick
from tests.replay.games import MILLISECOND, ListedSource, game, recorded
from tests.replay.test_recording import made, write
from vantage.replay.display import Display, clock_text, line
from vantage.replay.keys import wishes_in
from vantage.replay.playback import SECOND, SETTLE, SILENCE, Said
from vantage.replay.playback import Playback as Core
from vantage.replay.playing import Player, Quit, obey

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


class Stage:
    """A player without bus, terminal or time of its own."""

    def __init__(self, playback: Core) -> None:
        self.now = 0
        self.said: list[tuple[int, Said]] = []
        self.told: list[tuple[int, Message]] = []
        self.wishes: list[tuple[int, object]] = []
        display = Display(Console(file=io.StringIO()), keys=False)
        self.player = Player(
            playback,
            lambda said: self.said.append((self.now, said)),
            lambda key, message: self.told.append((self.now, message)),
            self.receive,
            lambda: self.now,
            display,
            games=2,
            once=True,
        )

    def receive(self, timeout: float) -> object:
        due = self.wishes[0][0] if self.wishes else None
        until = self.now + max(1, round(timeout * SECOND))
        if due is not None and due <= until:
            self.now = max(self.now, due)
            return self.wishes.pop(0)[1]
        self.now = until
        return None

    def health_times(self) -> list[int]:
        return [at for at, said in self.said if isinstance(said.message, Health)]


def test_a_log_is_played_to_its_end_at_its_own_times_and_told_twice_a_second() -> None:
    records = recorded(game(1, 5, 8, "ended"), [250 * MILLISECOND])
    stage = Stage(Core(ListedSource(records), lambda key, publisher: True, 0))
    stage.player.run()
    assert [said.message for _, said in stage.said] == [record.decode() for record in records]
    shifts = [at - (record.log_time - records[0].log_time) for (at, _), record in zip(stage.said, records, strict=True)]
    assert max(shifts) - min(shifts) < MILLISECOND
    times = [at for at, _ in stage.told]
    assert max(b - a for a, b in pairwise(times)) <= SECOND // 2 + MILLISECOND
    stage.player.finish()
    assert isinstance(last := stage.told[-1][1], Playback) and last.state == "ended"


def test_news_of_a_jump_comes_before_the_state_that_follows() -> None:
    stage = Stage(core())
    stage.wishes = [(SECOND // 2, Control(stamp=1, action="seek", position=1.5))]
    stage.player.run()
    told = next(at for at, report in stage.told if isinstance(report, Playback) and report.jumps == 1)
    setup = next(at for at, said in stage.said if at > SECOND // 2)
    assert told == SECOND // 2 and setup >= told + SETTLE


def test_while_the_log_stands_its_services_say_each_second_how_they_did() -> None:
    health = ("health/planner", Health(stamp=1, service="planner", state="ok", process=7, uptime=1.0))
    tick = ("tick", Tick(stamp=1, episode=1))
    records = recorded([health, tick, tick, tick, tick, tick, tick, tick, tick], [SECOND])
    stage = Stage(Core(ListedSource(records), lambda key, publisher: True, 0))
    stage.wishes = [(SECOND // 2, "pause"), (6 * SECOND, "pause")]
    stage.player.run()
    times = stage.health_times()
    assert sum(at <= 6 * SECOND for at in times) in (5, 6)
    assert all(b - a >= SECOND for a, b in pairwise(times))
    # The planner had fallen silent: once the log goes on, that shows.
    assert max(times) <= 6 * SECOND + SILENCE


@pytest.mark.parametrize(("position", "repeated"), [(1.5, True), (9.5, False)])
def test_who_had_fallen_silent_does_not_come_alive_where_somebody_goes(position: float, repeated: bool) -> None:
    health = ("health/planner", Health(stamp=1, service="planner", state="ok", process=7, uptime=1.0))
    tick = ("tick", Tick(stamp=1, episode=1))
    records = recorded([health, *[tick] * 12], [SECOND])
    stage = Stage(Core(ListedSource(records), lambda key, publisher: True, 0, paused=True))
    stage.wishes = [(SECOND // 2, Control(stamp=1, action="seek", position=position)), (8 * SECOND, "quit")]
    stage.player.run()
    times = [at for at in stage.health_times() if at > SECOND // 2]
    assert len(times) >= 5 if repeated else not times


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("nowhere.mcap",), "no such log or folder"),
        (("run.mcap", "--game", "7"), "no game 7 in this log; there is: 1, 2, 3"),
        (("run.mcap", "--from", "1e6"), "s long"),
        (("run.mcap", "--speed", "1000"), "0.1 to 100"),
        (("run.mcap", "--without", "referee"), "a live one would play its own"),
        (("run.mcap", "--without", "planer"), "--without planer: there is no such service; there is: simulator, "),
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
