"""What pages may cause on the bus, and how often."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from schemas import (
    Control,
)
from services.console import requests, wishes
from services.console.core import ALL_CONTROLS, OWN_CONTROLS
from services.console.rate import Shares
from tests.services.console_game import Table, health


def test_a_start_says_what_was_asked(table: Table) -> None:
    table.ask(requests.Start(seed=4, games=2, steps=30, layout="lab", seeker="expert", period=0.1, person="not stored: no human"))
    table.settle()
    control: Control = table.of("control")[-1]
    assert (control.action, control.seed, control.games) == ("start", 4, 2)
    assert (control.rules.maximum_steps, control.rules.layout, control.rules.step_period) == (30, "lab", 0.1)
    assert (control.players.hider, control.players.seeker, control.players.person) == ("planner", "expert", "")


@given(st.text(max_size=80))
def test_a_name_is_one_line_that_no_terminal_obeys(name: str) -> None:
    person = wishes.start(requests.Start(hider="human", person=name), 1).players.person
    assert person.isprintable()
    assert person == person.strip()
    assert "  " not in person
    letters = [letter for letter in name if letter.isprintable() and not letter.isspace()]
    assert [letter for letter in person if letter != " "] == letters
    assert wishes.start(requests.Start(hider="human", person="Ada\x1b[2J\u202e Lovelace"), 1).players.person == "Ada [2J Lovelace"


def test_pause_and_resume_where_there_is_nothing_are_refused_in_words(table: Table) -> None:
    table.ask(requests.Pause())
    table.ask(requests.Resume())
    table.settle()
    assert table.notices() == ["there is nothing to pause", "nothing is paused"]
    assert not table.of("control")


def test_a_game_is_paused_and_goes_on(table: Table) -> None:
    table.ask(requests.Start(steps=100))
    table.run(lambda: len(table.of("tick")) > 3)
    table.ask(requests.Pause())
    table.run(lambda: table.of("episode")[-1].paused)
    table.settle()
    assert table.header("session")["paused"] is True
    table.run_for(2.0)
    ticks = len(table.of("tick"))
    table.run_for(3.0)
    assert len(table.of("tick")) == ticks
    table.ask(requests.Resume())
    table.run(lambda: len(table.of("tick")) > ticks + 2)
    assert table.header("session")["paused"] is False


def test_control_is_spoken_at_a_bounded_rate(table: Table) -> None:
    for wish in (requests.Stop(), requests.Start()):
        before = len(table.of("control"))
        for _ in range(500):
            table.ask(wish)
        table.settle()
        assert len(table.of("control")) == before + OWN_CONTROLS[1]
        assert sum("too much" in text for text in table.notices()) == 500 - OWN_CONTROLS[1]
        table.pages.seen[1].clear()
        table.run_for(10.0)
    table.ask(requests.Stop())
    table.settle()
    assert len(table.of("control")) == 2 * OWN_CONTROLS[1] + 1


def test_pages_together_are_bounded_but_none_is_kept_from_stopping(table: Table) -> None:
    others = [table.come(number) for number in range(10, 30)]
    table.ask(requests.Start(games=0))
    table.run(lambda: len(table.of("tick")) > 3)
    table.run_for(5.0)
    for _ in range(20):
        for other in others:
            table.ask(requests.Start(steps=3), other)
    table.ask(requests.Pause())
    table.ask(requests.Start())
    table.ask(requests.Stop())
    table.settle()
    said = [control.action for control in table.of("control")]
    assert said.count("start") == 1 + ALL_CONTROLS[1]
    assert said[-2:] == ["pause", "stop"]
    assert table.notices()[-1] == "too much is asked at once: try again in a second"


def test_buckets_of_pages_that_are_gone_are_forgotten() -> None:
    shares = Shares((1.0, 2.0), (100.0, 100.0))
    assert [shares.take(1, 0.0, urgent=False) for _ in range(3)] == [True, True, False]
    shares.forget(1)
    assert not shares._pages
    assert shares.take(1, 0.0, urgent=False)


def test_a_request_of_a_page_that_is_gone_is_nothing(table: Table) -> None:
    table.go()
    table.ask(requests.Stop())
    table.settle()
    assert not table.of("control")


def test_a_silent_referee_is_mentioned(table: Table) -> None:
    table.ask(requests.Start())
    table.settle()
    assert "the referee is silent" in table.notices()[-1]
    table.network.sessions["referee"].publish("health/referee", health("referee", table.now))
    table.ask(requests.Start())
    table.settle()
    assert len(table.notices()) == 1
