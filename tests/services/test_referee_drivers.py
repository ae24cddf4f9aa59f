"""The referee waits for who drives the robots: a planner, a human at the console, a service of any name."""

import pytest

from schemas import Episode, Players, Rules, Tick
from services.referee.core import RefereeCore, RefereeSettings
from tests.services.referee_table import PACED, REAL, Table, messages
from vantage.service import SECOND, Changed, Woken


def test_no_game_without_a_driver() -> None:
    core = RefereeCore(RefereeSettings(autoplay=True, required=REAL, settle=0.0))
    core.step(Woken(), 0)
    core.step(Woken(), 0)
    for name in ("tracker", "seeker", "planner"):
        assert messages(core.step(Changed(name, True), 0)) == []
    assert len(messages(core.step(Changed("robot", True), 0))) == 1


def test_one_of_two_services_embodies_the_robots() -> None:
    for world in ("simulator", "tracker"):
        core = RefereeCore(RefereeSettings(autoplay=True, required=("simulator|tracker", "seeker"), settle=0.0))
        assert not core.step(Woken(), 0) and not core.step(Woken(), 0)
        assert messages(core.step(Changed("seeker", True), 0)) == []
        (setup,) = messages(core.step(Changed(world, True), 0))
        assert isinstance(setup, Episode)


HUMAN = Players(hider="human", person="Ada")


def test_a_human_plays_where_a_console_is_alive() -> None:
    table = Table()
    table.arrive()
    table.console_says()
    (setup,) = table.ask("start", players=HUMAN)
    assert isinstance(setup, Episode) and (setup.phase, setup.players) == ("setup", HUMAN)


def test_a_console_that_was_just_started_is_waited_for() -> None:
    table = Table()
    table.arrive()
    assert table.ask("start", players=HUMAN) == []
    table.now += 2 * SECOND
    (setup,) = table.console_says()
    assert isinstance(setup, Episode) and setup.phase == "setup"


@pytest.mark.parametrize(("hider", "seconds"), [("human", 5.0), ("nobody", 0.0)])
def test_a_game_that_nobody_drives_ends_soon_and_says_why(hider: str, seconds: float) -> None:
    table = Table()
    table.arrive()
    asked = table.now
    sent = table.ask("start", games=5, players=Players(hider=hider)) or table.wake()
    assert [(type(message), message.phase) for message in sent] == [(Episode, "setup"), (Episode, "aborted")]  # type: ignore[attr-defined]
    assert ("no console is alive" if hider == "human" else "`nobody`") in sent[1].reason  # type: ignore[attr-defined]
    assert table.now - asked == seconds * SECOND
    assert table.wake() == [] and table.core.wake_at() is None  # nor are the other four tried


def test_each_wish_waits_for_the_console_anew() -> None:
    table = Table()
    table.arrive()
    table.ask("start", players=HUMAN)
    table.now += 4 * SECOND
    table.ask("start", players=HUMAN)
    again = table.now
    _, aborted = table.wake()
    assert isinstance(aborted, Episode) and "no console" in aborted.reason and table.now == again + 5 * SECOND
    table.ask("start", players=HUMAN)
    table.now += SECOND
    table.send(Changed("planner", False))
    assert table.wake() == []  # it is the planner that is waited for now
    table.now += 60 * SECOND
    assert table.send(Changed("planner", True)) == []
    (setup,) = table.console_says()
    assert isinstance(setup, Episode) and setup.phase == "setup"


@pytest.mark.parametrize("rules", [Rules(step_period=0.0), PACED])
@pytest.mark.parametrize("step", [0, 1])
def test_a_human_whose_console_dies_is_not_waited_for(rules: Rules, step: int) -> None:
    table = Table()
    table.arrive()
    table.console_says()
    table.ask("start", players=HUMAN, rules=rules)
    table.pose("hider", 0.2, 0)
    table.pose("seeker", 0.6, 0)
    if step:
        table.play_step(0, 0.2, 0.6)
        if rules.step_period:
            table.wake()
    died = table.now
    sent: list[object] = []
    at = step
    while not any(isinstance(message, Episode) for message in sent):
        table.command("seeker", at)
        sent = table.wake()
        if sent and isinstance(sent[0], Tick):
            assert sent[0].late == ("hider",)
            table.pose("hider", 0.2, at + 1)
            table.pose("seeker", 0.6, at + 1)
            at += 1
    (aborted,) = sent
    assert isinstance(aborted, Episode) and "no console is alive" in aborted.reason
    assert table.now - died <= 7 * SECOND


def test_a_human_has_as_long_for_the_first_command_as_a_planner() -> None:
    table = Table()
    table.arrive()
    table.console_says()
    table.ask("start", players=HUMAN, rules=PACED)
    table.pose("hider", 0.2, 0)
    table.pose("seeker", 0.6, 0)
    began = table.now
    table.command("seeker", 0)
    while table.now < began + 29 * SECOND:
        table.console_says()
        assert table.wake() == []
    table.console_says()
    (aborted,) = table.wake()
    assert isinstance(aborted, Episode) and "no command from the hider for step 0" in aborted.reason
    assert table.now == began + 30 * SECOND


def test_a_service_of_the_name_hider_drives_what_it_is_asked_for() -> None:
    core = RefereeCore(RefereeSettings(autoplay=True, required=("hider",), players=Players(hider="goal-walk"), settle=0.0))
    core.step(Woken(), 0)
    core.step(Woken(), 0)
    (setup,) = messages(core.step(Changed("hider", True), 0))
    assert isinstance(setup, Episode) and setup.phase == "setup"
