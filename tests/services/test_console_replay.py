"""A log on the bus: what is shown of it, and that nobody plays in it."""

from __future__ import annotations

from typing import Any

import pytest

from schemas import Episode, Message, Playback, Pose, StateImage
from services.console import requests
from services.console.core import ConsoleCore
from services.console.events import PAGE, PageEvent
from tests.services.console_game import Table, parse, play
from tests.services.console_human import begin, to_step
from vantage.service import Arrived, Captured, Write


def playback(table: Table, jumps: int = 0, position: float = 1.0, **more: Any) -> tuple[str, Playback]:
    fields = {"log": "table.mcap", "position": position, "duration": 60.0, "jumps": jumps, **more}
    return "playback", Playback(stamp=table.now, **fields)


@pytest.mark.parametrize(
    ("state", "again"),
    [("playing", {"log": "other.mcap", "position": 30.0}), ("playing", {"position": 0.0}), ("ended", {"position": 30.0})],
)
def test_another_replay_is_not_mixed_with_the_one_before(table: Table, state: str, again: dict[str, Any]) -> None:
    table.say("replay", [playback(table, position=29.0)])
    play_log(table, number=1, seed=3)
    assert table.header("score")["games"] == 1
    table.say("replay", [playback(table, position=30.0, state=state), playback(table, **again)])
    assert table.header("playback")["forget"] is True
    late = table.come(4)
    table.ask(requests.Views(episode=1, steps=(0,)), late)
    table.settle()
    assert table.header("score", late)["games"] == 0
    keys = {header["key"] for header, _ in table.pages.seen[late]}
    assert keys == {"welcome", "playback", "services", "recording", "score", "session"}


def test_one_replay_that_goes_on_or_pauses_forgets_nothing(table: Table) -> None:
    table.say("replay", [playback(table, position=1.0 + 0.5 * number) for number in range(5)])
    table.say("replay", [playback(table, position=3.0, state="paused"), playback(table, position=2.999)])
    table.say("replay", [playback(table, position=60.0), playback(table, position=60.0, state="ended")])
    assert not [header for header, _ in table.frames("playback") if header.get("forget")]


def play_log(table: Table, number: int, seed: int) -> None:
    """A game as a log holds it, of two steps."""
    common: dict[str, Any] = {"stamp": table.now, "episode": number}
    table.say("referee", [("episode", Episode(**common, seed=seed, phase="setup"))])
    for step in range(2):
        table.say("simulator", [("hider/pose", Pose(**common, step=step, x=0.1 * seed, y=0.5, heading=0.0))])
        table.say("seeker", [("seeker/view", StateImage(**common, step=step, data=bytes([seed % 5]) * 128 * 128))])
    table.say("referee", [("episode", Episode(**common, step=2, seed=seed, phase="ended", outcome="survived"))])


@pytest.mark.parametrize("seed", [3, 4])
def test_a_number_that_is_used_again_is_another_game(seed: int) -> None:
    """A referee that was started anew counts from one again, perhaps with the same seed."""
    core = ConsoleCore({})
    common: dict[str, Any] = {"stamp": 1, "episode": 1}

    def hear(key: str, message: Message) -> None:
        core.step(Arrived(key, message), 1)

    def shown_to(client: int, *asked: requests.AnyRequest) -> dict[str, dict[str, Any]]:
        sends = [send for request in (None, *asked) for send in core.step(Captured(PAGE, PageEvent(client, request), 1), 1)]
        headers = [parse(send.data[4:])[0] for send in sends if isinstance(send, Write)]
        return {header["key"]: header for header in headers}

    def play_once(seed: int) -> None:
        hear("episode", Episode(**common, seed=seed, phase="setup"))
        for step in range(2):
            hear("hider/pose", Pose(**common, step=step, x=0.1 * seed, y=0.5, heading=0.0))
            hear("seeker/view", StateImage(**common, step=step, data=bytes([seed % 5]) * 128 * 128))
        hear("episode", Episode(**common, step=2, seed=seed, phase="ended", outcome="survived"))

    own = {"welcome", "episode", "services", "recording", "score", "session"}
    past = requests.Views(episode=1, steps=(0,))
    play_once(3)
    assert set(shown_to(1, past)) == own | {"hider/pose", "seeker/view", "driven", "past/0"}
    hear("episode", Episode(**common, seed=seed, phase="setup"))
    assert set(shown_to(2, past)) == own
    play_once(seed)
    shown = shown_to(3)
    assert shown["score"]["survived"] == 2
    assert shown["driven"]["hider"] == [[step, pytest.approx(0.1 * seed), 0.5] for step in range(2)]


def test_after_a_jump_nothing_of_before_is_shown(table: Table) -> None:
    play(table)
    table.say("replay", [playback(table)])
    assert table.header("playback") | {"stamp": ""} == {
        "key": "playback",
        "stamp": "",
        "episode": 0,
        "step": 0,
        "log": "table.mcap",
        "position": 1.0,
        "duration": 60.0,
        "speed": 1.0,
        "state": "playing",
        "jumps": 0,
    }
    table.come(2)
    table.settle()
    assert table.frames("hider/plan", 2)
    table.say("replay", [playback(table, jumps=1)])
    assert table.header("playback")["forget"] is True
    table.come(3)
    table.settle()
    keys = [header["key"] for header, _ in table.pages.seen[3]]
    assert set(keys) == {"welcome", "playback", "services", "recording", "score", "session"}
    assert table.header("score", 3)["games"] == 0
    table.say("replay", [playback(table, jumps=1, position=2.0)])
    assert "forget" not in table.header("playback")


def test_a_replay_is_wound_and_paused_and_plays_no_games(table: Table) -> None:
    table.ask(requests.Seek(position=3.0))
    table.settle()
    assert "no replay" in table.notices()[-1]
    table.say("replay", [playback(table)])
    for request in (requests.Start(), requests.Stop(), requests.Discard(episode=1)):
        table.ask(request)
    table.settle()
    assert not table.of("control")
    assert len(table.notices()) == 4
    for wish in (requests.Seek(position=3.5), requests.Pause(), requests.Resume(speed=4.0)):
        table.ask(wish)
    table.settle()
    seek, pause, resume = table.of("control")
    assert (seek.action, seek.position, pause.action, resume.action, resume.speed) == ("seek", 3.5, "pause", "resume", 4.0)


def test_where_a_replay_begins_nobody_is_at_the_wheel() -> None:
    table = Table()
    table.come()
    begin(table, steps=100)
    to_step(table, 1)
    assert table.header("session")["driver"] == 1
    table.say("replay", [playback(table)])
    assert table.header("session")["driver"] == 0
