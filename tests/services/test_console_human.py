"""A human plays the hider: games, sessions of several, and what of it is on the bus."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from schemas import ColorImage, Command, Control, DepthImage, Episode, Playback, Players, Pose, Rules, StateImage, Tick
from services.console import requests
from services.console.core import ConsoleCore
from services.console.events import PAGE, PageEvent
from services.console.human import HEARD, answer
from tests.services.console_game import Table, health
from tests.services.console_human import STEPS, begin, commands, step_of, to_end, to_step
from vantage.perception.state_image import perceive
from vantage.service import Arrived, Captured, Core, Publish
from vantage.world.camera import Camera


@pytest.fixture
def others() -> dict[str, Core]:
    """People drive: no planner, no networks."""
    return {}


def test_every_step_is_answered_as_any_hider_answers_it(table: Table) -> None:
    begin(table)
    table.run(lambda: bool(table.of("episode")))
    table.ask(requests.Drive(primitive="left", held=True))
    to_end(table)
    episode: Episode = table.of("episode")[-1]
    assert (episode.phase, episode.players.hider) == ("ended", "human")
    steps = [tick.step for tick in table.of("tick") if not tick.late]
    assert [command.step for command in commands(table)] == steps
    assert not [tick for tick in table.of("tick") if tick.late]
    assert [command.primitive for command in commands(table)] == ["left"] * len(steps)
    for command, view, depth, color, pose in zip(
        *(commands(table), table.of("hider/view"), table.of("hider/depth"), table.of("hider/color"), table.of("hider/pose")),
        strict=False,
    ):
        assert isinstance(depth, DepthImage) and isinstance(color, ColorImage) and isinstance(pose, Pose)
        assert (command.stamp, command.episode, command.step) == (depth.stamp, depth.episode, depth.step)
        assert (view.stamp, view.step) == (depth.stamp, depth.step)
        assert view.data == perceive(depth, color, pose, "hider").image.tobytes()
    assert table.frames("hider/view")


def test_the_robot_goes_where_it_is_driven(table: Table) -> None:
    begin(table, steps=30)
    to_step(table, 0)
    table.ask(requests.Drive(primitive="forward", held=True))
    to_step(table, 3)
    table.ask(requests.Drive(primitive="forward", held=False))
    table.ask(requests.Drive(primitive="left", held=True))
    table.ask(requests.Drive(primitive="left", held=False))
    to_step(table, 7)
    said = [command.primitive for command in commands(table)]
    assert said[:8] == ["stay", "forward", "forward", "forward", "left", "stay", "stay", "stay"]


def test_a_person_is_stored_only_if_one_is_given(table: Table) -> None:
    begin(table)
    to_end(table)
    assert {episode.players.person for episode in table.of("episode")} == {""}
    begin(table, person="  Ada \n Lovelace ")
    to_end(table, 2)
    assert table.of("episode")[-1].players.person == "Ada Lovelace"
    assert not [header for header, _ in table.pages.seen[1] if "Lovelace" in str(header)]


def test_a_session_of_several_games_with_one_taken_back(table: Table) -> None:
    begin(table, games=3, steps=4)
    to_end(table)
    session = table.header("session")
    first = table.of("episode")[-1]
    assert session | {"key": ""} == {
        "key": "",
        "driver": 1,
        "more_games": True,
        "paused": False,
        "last": {"episode": first.episode, "discarded": False},
    }
    table.ask(requests.Discard(episode=first.episode))
    table.settle()
    assert table.header("session")["last"]["discarded"] is True
    assert table.header("score")["discarded"] == 1
    to_end(table, 3)
    session = table.header("session")
    assert (session["more_games"], session["last"]["discarded"]) == (False, False)
    assert [episode.seed for episode in table.of("episode") if episode.phase == "setup"] == [5, 6, 7]


def test_a_running_game_is_discarded(table: Table) -> None:
    begin(table, steps=100)
    to_step(table, 3)
    table.ask(requests.Discard(episode=table.of("episode")[-1].episode))
    to_end(table)
    assert table.of("episode")[-1].phase == "aborted"
    assert table.header("score")["discarded"] == 1
    assert table.header("score")["aborted"] == 0


def silence(table: Table, console_frozen: bool = False) -> None:
    """Nothing is heard of the console any more; `console_frozen`: it hears and answers nothing either (a stopped process)."""
    table.silent = True
    if console_frozen:
        table.runtimes.remove(table.console)


def phases(table: Table) -> list[tuple[int, str]]:
    return [(episode.episode, episode.phase) for episode in table.of("episode") if episode.phase != "running"]


@pytest.mark.parametrize("hider", ["human", "nobody"])
def test_games_set_up_without_a_driver_are_given_up_and_no_more_are_promised(table: Table, hider: str) -> None:
    silence(table)
    table.run_for(6.0)
    line = table.network.session("command-line")
    rules, players = Rules(maximum_steps=STEPS), Players(hider=hider)
    line.publish("control", Control(stamp=table.now, action="start", games=3, rules=rules, players=players))
    to_end(table)
    assert [header["more_games"] for header, _ in table.frames("session")][-2:] == [True, False]
    table.run_for(60.0)
    assert phases(table) == [(1, "setup"), (1, "aborted")]


@pytest.mark.parametrize("comes_back", [True, False])
def test_after_a_game_that_lost_its_driver_another_one_is_tried(table: Table, comes_back: bool) -> None:
    """The referee tries the next game for some seconds: whoever comes back in time plays it."""
    begin(table, games=3)
    to_step(table, 2)
    silence(table, console_frozen=True)
    to_end(table)
    assert "no console is alive" in table.of("episode")[-1].reason
    if not comes_back:
        to_end(table, 2)
    table.runtimes.append(table.console)
    table.silent = False
    table.settle()
    assert table.header("session")["more_games"] is comes_back
    table.run_for(60.0)
    first = [(1, "setup"), (1, "aborted"), (2, "setup")]
    assert phases(table) == [*first, *([(2, "ended"), (3, "setup"), (3, "ended")] if comes_back else [(2, "aborted")])]
    assert table.header("session")["more_games"] is False


def test_a_referee_that_was_restarted_plays_no_more_of_the_games_and_none_are_promised(table: Table) -> None:
    says = health("referee", table.now)
    table.say("referee", [("health/referee", says)])
    begin(table, games=3)
    to_step(table, 2)
    table.ask(requests.Pause())
    table.run(lambda: table.of("episode")[-1].paused)
    table.say("referee", [("health/referee", says)])
    assert (table.header("session")["more_games"], table.header("session")["paused"]) == (True, True)
    table.restart_referee()
    table.say("referee", [("health/referee", replace(says, process=says.process + 1))])
    assert (table.header("session")["more_games"], table.header("session")["paused"]) == (False, False)
    table.run_for(60.0)
    assert phases(table) == [(1, "setup"), (1, "aborted")]
    begin(table, games=2)
    table.settle()
    assert table.header("session")["more_games"] is True


def test_what_was_tapped_during_a_pause_does_not_move_the_robot(table: Table) -> None:
    begin(table, steps=100)
    to_step(table, 2)
    table.ask(requests.Pause())
    table.run(lambda: table.of("episode")[-1].paused)
    table.run_for(1.0)
    at = step_of(table)
    table.ask(requests.Drive(primitive="forward", held=True))
    table.ask(requests.Drive(primitive="forward", held=False))
    table.ask(requests.Resume())
    to_step(table, at + 3)
    assert {command.primitive for command in commands(table)} == {"stay"}


def test_a_human_needs_a_pace(table: Table) -> None:
    begin(table, period=0.0)
    table.settle()
    assert "too short for a human" in table.notices()[-1]
    assert not table.of("control")


@pytest.mark.parametrize("hider", ["human", "planner"])
def test_in_games_of_the_planner_the_console_is_silent(table: Table, hider: str) -> None:
    """The same poses, pictures and ticks that it answers where a human drives."""
    begin(table)
    to_end(table)
    core = ConsoleCore({})
    said: list[Publish] = []
    for received in [
        Captured(PAGE, PageEvent(1), 1),
        *(
            Arrived(key, replace(message, players=Players(hider=hider)) if isinstance(message, Episode) else message)
            for key, message in table.said
            if key in ("episode", *HEARD)
        ),
    ]:
        now = received.message.stamp if isinstance(received, Arrived) else 1
        drive = Captured(PAGE, PageEvent(1, requests.Drive(primitive="left", held=True)), now)
        said += [send for event in (received, drive) for send in core.step(event, now) if isinstance(send, Publish)]
    steps = len([tick for tick in table.of("tick") if not tick.late])
    assert steps > 3
    keys = [send.key for send in said]
    assert keys == (["hider/view", "hider/command"] * steps if hider == "human" else [])


@pytest.fixture
def replayed(table: Table) -> Table:
    table.say("replay", [("playback", Playback(stamp=table.now, log="x", position=0.0, duration=9.0))])
    return table


def test_a_replayed_game_of_a_human_is_left_alone(replayed: Table) -> None:
    table = replayed
    players = Players(hider="human")
    referee = table.network.sessions["referee"]
    referee.publish("episode", Episode(stamp=table.now, episode=9, seed=3, phase="setup", players=players))
    table.run_for(3.0)
    referee.publish("episode", Episode(stamp=table.now, episode=9, seed=3, phase="running", players=players))
    table.ask(requests.Drive(primitive="left", held=True))
    table.run_for(3.0)
    assert not table.of("control")
    assert not commands(table)
    table.say("replay", [("playback", Playback(stamp=table.now, log="x", position=0.0, duration=9.0, jumps=1))])
    table.run_for(3.0)
    assert not table.of("control")


def test_an_answer_carries_the_time_of_the_depth_picture() -> None:
    place = {"episode": 3, "step": 7}
    picture: dict[str, Any] = {"width": 160, "height": 1, "intrinsics": Camera(width=160, height=120).intrinsics()}
    complete = (
        Pose(stamp=1, x=0.6, y=0.6, heading=0.0, **place),
        DepthImage(stamp=2, data=bytes(320), **picture, **place),
        ColorImage(stamp=3, data=bytes(480), **picture, **place),
        Tick(stamp=4, **place),
    )
    image, command = (send.message for send in answer(complete, "left") if isinstance(send, Publish))
    assert isinstance(image, StateImage) and isinstance(command, Command)
    assert [(message.stamp, message.episode, message.step) for message in (image, command)] == [(2, 3, 7)] * 2
    assert command.primitive == "left"
