"""A service's core in a replay that jumps to and fro, in one thread and without a bus."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

from learning.collect import CollectSettings, play_block
from schemas import Command, Episode
from services.console.core import ConsoleCore
from services.console.events import PAGE, PageEvent
from services.seeker.core import SeekerCore
from tests.learning.test_human_games import record_games
from vantage.log import read
from vantage.replay.cast import cast
from vantage.replay.playback import SECOND, Playback
from vantage.replay.recording import Recording
from vantage.service import Arrived, Captured, Publish, Received, Unexpected, Woken, Write


def test_the_seeker_joins_an_earlier_game_and_says_again_what_was_recorded(tmp_path: Path) -> None:
    path = tmp_path / "games.mcap"
    play_block(CollectSettings(hider="random", steps=8, catching=False), range(1, 3), path)
    recording = Recording(path)
    assert len(recording.games) == 2
    core, now, unexpected = SeekerCore(), 0, 0
    playback = Playback(recording, lambda key, publisher: True, now, speed=4.0)
    said: list[Command] = []

    def go_on(until: int) -> None:
        """Play until `until` steps of the game reached have been answered."""
        nonlocal now, unexpected
        said.clear()
        while len(said) < until and playback.state != "ended":
            now += SECOND // 200
            for each in playback.turn(now):
                if each.key not in core.declaration.inputs:
                    continue
                try:
                    sends = core.step(Arrived(each.key, each.message), now)
                except Unexpected:
                    unexpected += 1
                else:
                    said.extend(send.message for send in sends if isinstance(send, Publish) and send.key == "seeker/command")

    def recorded(game: int) -> list[Command]:
        number = recording.games[game].number
        return [m for record in read(path, topics={"seeker/command"}) for m in [record.decode()] if m.episode == number]  # type: ignore[misc]

    jumps = (1, 0, 1, 0, 0)
    for game in jumps:
        playback.seek_game(game, now)
        expected = recorded(game)[:4]
        go_on(len(expected))
        assert [(m.episode, m.step, m.primitive) for m in said] == [(m.episode, m.step, m.primitive) for m in expected]
    assert unexpected <= 3 * len(jumps)
    recording.close()


def test_a_console_takes_no_part_in_a_humans_games_that_are_replayed(tmp_path: Path) -> None:
    """However somebody jumps about in them: it would drive a second time, pause them, or count them as given up."""
    recording = Recording(record_games(tmp_path / "human.mcap"))
    parts = cast(recording.publishers, {"console", "predictor"}, ())
    assert parts.voices["hider/command", "console"] == "hider"
    core, now = ConsoleCore({}), 0
    playback = Playback(recording, lambda key, publisher: (key, publisher) in parts.voices, now, speed=20.0)
    shown = sends = 0

    def tell(received: Received) -> None:
        nonlocal shown, sends
        for send in core.step(received, now):
            shown += isinstance(send, Write)
            sends += not isinstance(send, Write)

    tell(Captured(PAGE, PageEvent(1), now))
    draw = Random(4)
    for _ in range(40):
        report, heard = playback.report(now), set[tuple[int, int]]()
        tell(Arrived("playback", report))
        for _ in range(draw.randrange(10, 200)):
            now += SECOND // 100
            for said in playback.turn(now):
                if said.key == "hider/command":
                    place = said.message.episode, said.message.step
                    assert place not in heard and place[0] >= report.episode, "of the games from there on, each once"
                    heard.add(place)
                if said.key in core.declaration.inputs:
                    tell(Arrived(said.key, said.message))
            wake = core.wake_at()
            if wake is not None and wake <= now:
                tell(Woken())
        playback.seek(draw.uniform(0.0, (recording.end - recording.start) / SECOND), now)
    assert shown > 500 and sends == 0 and not playback.skipped
    recording.close()


def test_a_word_on_an_earlier_game_that_is_no_set_up_is_still_set_aside() -> None:
    core = SeekerCore()
    core.step(Arrived("episode", Episode(stamp=1, episode=5, seed=1, phase="setup")), 0)
    with pytest.raises(Unexpected, match="episode 4 came after episode 5"):
        core.step(Arrived("episode", Episode(stamp=1, episode=4, seed=1, phase="running")), 0)
