"""The score: each game counts once, as it stands now, and only where it was seen to be played."""

from __future__ import annotations

from typing import Any

import pytest

from schemas import (
    Episode,
)
from services.console import requests
from services.console.score import Score
from tests.services.console_game import STEPS, Table, parse, play


def ended(number: int, outcome: str = "survived", step: int = 10, phase: str = "ended") -> Episode:
    return Episode(stamp=1, episode=number, step=step, seed=number, phase=phase, outcome=outcome)  # type: ignore[arg-type]


def begun(number: int) -> Episode:
    return Episode(stamp=1, episode=number, seed=number, phase="setup")


def score_of(score: Score) -> dict[str, Any]:
    header, _ = parse(score.frame())
    del header["key"]
    return header


def test_the_score_counts_each_game_once_and_as_it_stands_now() -> None:
    score = Score()
    assert score_of(score)["mean_steps"] is None
    for number, (outcome, step) in enumerate((("survived", 100), ("caught", 40), ("caught", 20)), start=1):
        score.add(begun(number))
        score.add(ended(number, outcome, step))
        score.add(ended(number, outcome, step))
    score.add(begun(4))
    score.add(ended(4, "undecided", 7, "aborted"))
    counts = {"games": 4, "survived": 1, "caught": 2, "aborted": 1, "discarded": 0}
    assert score_of(score) == {**counts, "mean_steps": pytest.approx(160 / 3)}
    score.discard(2)
    score.discard(2)
    assert score_of(score) == {**counts, "caught": 1, "discarded": 1, "mean_steps": pytest.approx(60)}


def test_a_running_game_that_is_discarded_is_not_aborted_besides() -> None:
    score = Score()
    score.add(begun(1))
    score.discard(1)
    score.add(ended(1, "undecided", 3, "aborted"))
    assert score_of(score) | {"mean_steps": None} == {
        "games": 1,
        "survived": 0,
        "caught": 0,
        "aborted": 0,
        "discarded": 1,
        "mean_steps": None,
    }


def test_a_referee_that_counts_anew_is_counted_on() -> None:
    score = Score()
    for _ in range(3):
        score.add(begun(1))
        score.add(ended(1))
    assert score_of(score)["survived"] == 3


def test_the_score_does_not_grow() -> None:
    score = Score()
    for number in range(1, 3000):
        score.add(begun(number))
        score.add(ended(number))
    assert score_of(score)["survived"] == 2999
    assert len(score._games) <= 1000
    assert len(score._steps) <= 1000


def test_a_game_goes_into_the_score_and_can_be_taken_back(table: Table) -> None:
    play(table)
    outcome = table.of("episode")[-1].outcome
    assert table.header("score")[outcome] == 1
    table.ask(requests.Discard(episode=table.of("episode")[-1].episode))
    table.settle()
    assert table.of("control")[-1].action == "discard"
    assert table.header("score") | {"mean_steps": None} == {
        "key": "score",
        "games": 1,
        "survived": 0,
        "caught": 0,
        "aborted": 0,
        "discarded": 1,
        "mean_steps": None,
    }
    table.ask(requests.Discard(episode=table.of("episode")[-1].episode))
    table.ask(requests.Discard(episode=77))
    table.settle()
    assert sum(control.action == "discard" for control in table.of("control")) == 1
    assert len([text for text in table.notices() if "taken back" in text]) == 2


def test_a_game_that_was_over_before_the_console_started_is_not_counted(table: Table) -> None:
    play(table)
    table.restart_console()
    table.come()
    table.settle()
    assert table.header("episode")["phase"] == "ended"
    assert table.header("score")["games"] == 0
    table.ask(requests.Discard(episode=table.of("episode")[-1].episode))
    table.settle()
    assert table.of("control")[-1].action == "discard"
    assert table.header("session")["last"]["discarded"] is True
    play(table)
    assert table.header("score")["games"] == 2  # the one that was taken back, and this one


def test_a_game_that_was_running_when_the_console_started_is_counted(table: Table) -> None:
    table.ask(requests.Start(steps=STEPS))
    table.run(lambda: len(table.of("tick")) > 3)
    table.restart_console()
    table.come()
    table.run(lambda: table.of("episode")[-1].phase == "ended")
    table.settle()
    assert table.header("score")["games"] == 1
