"""A human plays the hider: keys, wheel, pauses, sessions; and what of it is on the bus."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from schemas import PRIMITIVES, ColorImage, Command, Control, DepthImage, Episode, Playback, Players, Pose, Primitive, Rules
from services.console import requests
from services.console.core import ConsoleCore
from services.console.events import PAGE, PageEvent
from services.console.human import HEARD, Keys
from services.console.wheel import GRACE
from tests.services.console_game import Table
from vantage.perception.state_image import perceive
from vantage.service import SECOND, Arrived, Captured, Publish

STEPS = 12


@pytest.fixture
def table() -> Table:
    table = Table()
    table.come()
    table.run_for(1.0)
    return table


def begin(table: Table, client: int = 1, **more: Any) -> None:
    table.ask(requests.Start(hider="human", **{"steps": STEPS, "seed": 5, **more}), client)


def commands(table: Table) -> list[Command]:
    return table.of("hider/command")


def step_of(table: Table) -> int:
    return max((command.step for command in commands(table)), default=-1)


def to_step(table: Table, step: int) -> None:
    table.run(lambda: step_of(table) >= step)


def to_end(table: Table, games: int = 1) -> None:
    table.run(lambda: sum(episode.phase in ("ended", "aborted") for episode in table.of("episode")) >= games)
    table.settle()


# Keys


def test_what_is_held_counts_at_every_step_the_last_pressed_first() -> None:
    keys = Keys()
    assert keys.take() == "stay"
    keys.press("forward")
    assert [keys.take() for _ in range(3)] == ["forward"] * 3
    keys.press("left")
    assert keys.take() == "left"
    keys.release("left")
    assert keys.take() == "forward"
    keys.release("forward")
    assert keys.take() == "stay"


def test_a_tap_between_two_steps_counts_once_also_while_another_key_is_held() -> None:
    keys = Keys()
    keys.press("left")
    keys.release("left")
    assert [keys.take(), keys.take()] == ["left", "stay"]
    keys.press("forward")
    keys.take()
    keys.press("right")
    keys.release("right")
    assert [keys.take(), keys.take()] == ["right", "forward"]
    for _ in range(3):
        keys.press("left")
        keys.release("left")
    assert [keys.take(), keys.take()] == ["left", "forward"]


events = st.lists(st.tuples(st.sampled_from(["press", "release", "step"]), st.sampled_from(PRIMITIVES)), max_size=60)


@given(events)
def test_no_key_acts_longer_than_it_was_held(played: list[tuple[str, Primitive]]) -> None:
    """Each step's primitive was held at the step, or came and went since the step before; and keys that came are not lost."""
    keys = Keys()
    held: list[Primitive] = []
    tapped: list[Primitive] = []
    fresh: set[Primitive] = set()
    for what, primitive in played:
        if what == "press":
            keys.press(primitive)
            if primitive not in held:
                held.append(primitive)
                fresh.add(primitive)
        elif what == "release":
            keys.release(primitive)
            if primitive in held:
                held.remove(primitive)
                if primitive in fresh:
                    tapped.append(primitive)
                    fresh.discard(primitive)
        else:
            taken = keys.take()
            if tapped:
                assert taken == tapped[-1]
            else:
                assert taken == (held[-1] if held else "stay")
                fresh.discard(taken)
            tapped.clear()


# Games


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


# The wheel


def test_when_the_driver_goes_the_robot_stays_and_the_game_is_paused_until_somebody_takes_the_wheel(table: Table) -> None:
    begin(table, steps=100)
    to_step(table, 0)
    table.ask(requests.Drive(primitive="left", held=True))
    to_step(table, 3)
    table.go()
    table.come(2)
    table.run(lambda: table.of("episode")[-1].paused)
    table.run_for(2.0)
    at = step_of(table)
    assert at <= 5
    assert all(command.primitive == "stay" for command in commands(table) if command.step > 3)
    assert (table.header("session", 2)["driver"], table.header("session", 2)["paused"]) == (0, True)
    table.run_for(20.0)
    assert step_of(table) == at
    assert [control.action for control in table.of("control")] == ["start", "pause"]
    table.ask(requests.Resume(), 2)
    to_step(table, at + 2)
    assert table.header("session", 2)["driver"] == 2
    table.ask(requests.Drive(primitive="right", held=True), 2)
    to_step(table, at + 4)
    assert commands(table)[-1].primitive == "right"
    assert not [tick for tick in table.of("tick") if tick.late]


def test_whoever_drives_first_has_the_wheel_and_others_are_told(table: Table) -> None:
    begin(table, steps=100)
    table.come(2)
    to_step(table, 1)
    table.ask(requests.Drive(primitive="left", held=True), 2)
    to_step(table, 3)
    assert {command.primitive for command in commands(table)} == {"stay"}
    assert table.notices(2) == ["somebody drives at another page"]
    table.ask(requests.Start(hider="human"), 2)
    table.settle()
    assert "somebody is playing" in table.notices(2)[-1]
    table.go(1)
    table.ask(requests.Drive(primitive="left", held=True), 2)
    table.run(lambda: table.of("episode")[-1].paused)
    table.ask(requests.Resume(), 2)
    at = step_of(table)
    to_step(table, at + 2)
    assert commands(table)[-1].primitive == "left"
    assert table.header("session", 2)["driver"] == 2


def test_another_page_cannot_end_somebodys_game_unless_it_is_paused(table: Table) -> None:
    begin(table, steps=100, games=2)
    table.come(2)
    to_step(table, 3)
    number = table.of("episode")[-1].episode
    for wish in (requests.Stop(), requests.Discard(episode=number)):
        table.ask(wish, 2)
    table.settle()
    assert [control.action for control in table.of("control")] == ["start"]
    assert [text for text in table.notices(2) if "pause that game first" in text] == table.notices(2)
    assert len(table.notices(2)) == 2
    table.ask(requests.Pause(), 2)
    table.run(lambda: table.of("episode")[-1].paused)
    table.ask(requests.Stop(), 2)
    to_end(table)
    assert table.of("episode")[-1].phase == "aborted"


def test_between_somebodys_games_too_and_the_driver_may_always_stop(table: Table) -> None:
    begin(table, steps=4, games=2)
    table.come(2)
    to_end(table)
    table.ask(requests.Stop(), 2)
    table.settle()
    assert "pause that game first" in table.notices(2)[-1]
    table.ask(requests.Stop())
    table.settle()
    assert [control.action for control in table.of("control")] == ["start", "stop"]


def test_whose_driver_is_gone_may_be_ended_by_anybody(table: Table) -> None:
    begin(table, steps=100)
    table.come(2)
    to_step(table, 3)
    table.go(1)
    table.settle()
    table.ask(requests.Stop(), 2)
    to_end(table)
    assert "stop" in [control.action for control in table.of("control")]


def test_a_driver_that_took_the_wheel_of_a_game_in_its_set_up_and_goes_pauses_it(table: Table) -> None:
    """The pause that the first driver left behind was taken back: the next one's going is a reason of its own."""
    table.come(2)
    begin(table, steps=100)
    table.run(lambda: bool(table.of("episode")))
    assert table.of("episode")[-1].phase == "setup"
    table.go(1)
    table.bus.post(Captured(PAGE, PageEvent(2, requests.Resume()), table.now))
    to_step(table, 3)
    assert table.header("session", 2)["driver"] == 2
    assert not table.of("episode")[-1].paused
    table.go(2)
    table.run(lambda: table.of("episode")[-1].paused)
    assert [control.action for control in table.of("control")] == ["start", "pause", "resume", "pause"]


def test_a_console_that_is_restarted_pauses_the_game_and_goes_on_with_it(table: Table) -> None:
    begin(table, steps=100)
    to_step(table, 3)
    table.restart_console()
    table.come(5)
    table.run(lambda: table.of("episode")[-1].paused)
    at = step_of(table)
    table.ask(requests.Resume(), 5)
    to_step(table, at + 3)
    assert table.header("session", 5)["driver"] == 5
    to_end(table)
    assert table.of("episode")[-1].phase == "ended"


def test_a_game_asked_for_elsewhere_waits_for_a_driver(table: Table) -> None:
    line = table.network.session("command-line")
    rules, players = Rules(maximum_steps=20), Players(hider="human")
    line.publish("control", Control(stamp=table.now, action="start", rules=rules, players=players))
    table.run(lambda: bool(table.of("episode")) and table.of("episode")[-1].paused)
    began = next(message for message in table.of("episode") if message.phase == "setup")
    assert table.now - began.stamp < GRACE + SECOND
    assert step_of(table) <= 1
    table.ask(requests.Drive(primitive="right", held=True))
    table.ask(requests.Resume())
    to_end(table)
    assert table.of("episode")[-1].phase == "ended"
    assert commands(table)[-1].primitive == "right"


def test_a_core_that_waits_for_a_driver_does_not_spin(table: Table) -> None:
    begin(table, steps=100)
    to_step(table, 2)
    table.go()
    table.run(lambda: table.of("episode")[-1].paused)
    table.run_for(5.0)
    table.settle()
    wake = table.core.wake_at()
    assert wake is not None
    assert wake > table.now


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
