"""Who is at the wheel of a human's game, who may end it, and that it stands still where nobody drives."""

from __future__ import annotations

import pytest

from schemas import Control, Episode, Players, Rules
from services.console import requests
from services.console.wheel import GRACE, Wheel
from tests.services.console_game import Table
from tests.services.console_human import begin, commands, step_of, to_end, to_step
from vantage.service import SECOND, Core, Publish


@pytest.fixture
def others() -> dict[str, Core]:
    """People drive: no planner, no networks."""
    return {}


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
    assert commands(table)[-1].primitive == "stay", "who takes the wheel does not hold the keys of who left it"
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


def test_a_pause_in_the_set_up_that_was_taken_back_is_asked_for_again_when_the_next_driver_goes() -> None:
    """In the set-up the referee confirms no pause, so that only `resume` tells that it is over."""
    wheel = Wheel()

    def episode(phase: str) -> Episode:
        return Episode(stamp=1, episode=1, seed=5, phase=phase, players=Players(hider="human"))  # type: ignore[arg-type]

    wheel.take(1)
    wheel.see(episode("setup"), True, 1)
    assert wheel.mind(1) == []
    wheel.leave()
    (asked,) = wheel.mind(2)
    assert isinstance(asked, Publish) and isinstance(asked.message, Control)
    wheel.hear(asked.message)
    assert wheel.mind(3) == []
    wheel.take(2)
    wheel.hear(Control(stamp=4, action="resume"))
    wheel.see(episode("running"), False, 5)
    assert wheel.mind(6) == []
    wheel.leave()
    (again,) = wheel.mind(7)
    assert isinstance(again, Publish) and again.message == Control(stamp=7, action="pause")


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


def test_every_driver_that_goes_leaves_a_paused_game(table: Table) -> None:
    begin(table, steps=100)
    to_step(table, 1)
    table.go()
    table.run(lambda: table.of("episode")[-1].paused)
    table.come(2)
    table.ask(requests.Resume(), 2)
    to_step(table, step_of(table) + 2)
    assert not table.of("episode")[-1].paused
    table.go(2)
    table.run(lambda: table.of("episode")[-1].paused)
    assert [control.action for control in table.of("control")] == ["start", "pause", "resume", "pause"]
