"""A service's core in a replay that jumps to and fro, in one thread and without a bus."""

from __future__ import annotations

from pathlib import Path

import pytest

from learning.collect import CollectSettings, play_block
from schemas import Command, Episode, Rules
from services.seeker.core import SeekerCore
from vantage.log import read
from vantage.replay.playback import SECOND, Playback
from vantage.replay.recording import Recording
from vantage.service import Arrived, Publish, Unexpected


def test_the_seeker_joins_an_earlier_game_and_says_again_what_was_recorded(tmp_path: Path) -> None:
    path = tmp_path / "games.mcap"
    play_block(CollectSettings(hider="random", rules=Rules(maximum_steps=8, catching=False)), range(1, 3), path)
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


def test_a_word_on_an_earlier_game_that_is_no_set_up_is_still_set_aside() -> None:
    core = SeekerCore()
    core.step(Arrived("episode", Episode(stamp=1, episode=5, seed=1, phase="setup")), 0)
    with pytest.raises(Unexpected, match="episode 4 came after episode 5"):
        core.step(Arrived("episode", Episode(stamp=1, episode=4, seed=1, phase="running")), 0)
