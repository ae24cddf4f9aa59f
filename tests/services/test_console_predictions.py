"""What the seeker would see on the way to a goal, and what it has seen."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from schemas import (
    GOAL_COUNT,
    PredictReply,
    PredictRequest,
    StateImage,
)
from services.console import requests
from services.console.past import PastViews
from services.console.prediction import HORIZONS, chosen_horizons
from tests.services.console_game import STEPS, Table, parse, play


def open_goals(table: Table) -> list[int]:
    return [goal for goal, value in enumerate(table.of("hider/plan")[-1].values) if value is not None]


def test_a_click_on_a_goal_shows_what_the_seeker_would_see_on_the_way(table: Table) -> None:
    play(table, steps=100)
    planned: PredictRequest = table.of("predictor/request")[0]
    goals = open_goals(table)
    goal = goals[len(goals) // 2]
    table.ask(requests.Predict(goal=goal))
    table.run(lambda: bool(table.frames("prediction")))
    header, payload = table.frames("prediction")[-1]
    assert (header["goal"], header["error"], header["episode"]) == (goal, "", planned.episode)
    assert len(header["steps"]) == HORIZONS
    assert header["steps"] == [planned.step + horizon for horizon in chosen_horizons(planned.horizons)]
    path = np.frombuffer(planned.paths, "<f4").reshape(planned.path_count, planned.path_steps, 2)[goals.index(goal)]
    np.testing.assert_allclose(header["path"], path, atol=1e-4)
    reply: PredictReply = table.of("predictor/reply")[-1]
    assert payload == b"".join(reply.views)
    assert len(payload) == HORIZONS * 128 * 128 * 3
    np.testing.assert_array_equal(np.float32(header["caught"]), np.frombuffer(reply.caught, "<f4"))
    # And it is what the planner was told when it painted the value map.
    told: PredictReply = table.of("predictor/reply")[0]
    caught = np.frombuffer(told.caught, "<f4").reshape(planned.path_count, -1)[goals.index(goal)]
    chosen = [planned.horizons.index(horizon) for horizon in chosen_horizons(planned.horizons)]
    np.testing.assert_allclose(header["caught"], caught[chosen], atol=1e-5)


def test_the_consoles_own_questions_are_not_taken_for_the_planners(table: Table) -> None:
    play(table, steps=20)
    goals = open_goals(table)
    for goal in goals[:3]:
        table.ask(requests.Predict(goal=goal))
        table.run(lambda goal=goal: bool(table.frames("prediction")) and table.header("prediction")["goal"] == goal)
        assert table.header("prediction")["error"] == ""


@pytest.mark.parametrize("steps", [1, 5, 9, 10, 40, 100, 1000])
def test_horizons_are_spread_and_end_with_the_last(steps: int) -> None:
    horizons = tuple(10 * (k + 1) - 1 for k in range(steps))
    chosen = chosen_horizons(horizons)
    assert len(chosen) == min(steps, HORIZONS)
    assert chosen[-1] == horizons[-1]
    assert list(chosen) == sorted(set(chosen))
    assert set(chosen) <= set(horizons)
    assert np.ptp(np.diff((-1, *chosen))) <= 20


def test_what_cannot_be_predicted_is_said(table: Table) -> None:
    table.ask(requests.Predict(goal=3))
    table.settle()
    assert "no plan" in table.header("prediction")["error"]
    play(table, steps=20)
    blocked = next(goal for goal in range(GOAL_COUNT) if goal not in open_goals(table))
    table.ask(requests.Predict(goal=blocked))
    table.settle()
    assert "blocked" in table.header("prediction")["error"]
    table.network.sessions["predictor"].close()
    table.runtimes = [runtime for runtime in table.runtimes if runtime.core.declaration.name != "predictor"]
    table.ask(requests.Predict(goal=open_goals(table)[0]))
    table.settle()
    assert table.header("prediction")["error"] == "nobody serves `predictor`: is predictor running?"
    assert table.header("prediction")["goal"] == open_goals(table)[0]


def test_a_predictor_that_hangs_ends_in_an_error(table: Table) -> None:
    play(table, steps=20)
    hanging = table.runtimes.pop([runtime.core.declaration.name for runtime in table.runtimes].index("predictor"))
    table.ask(requests.Predict(goal=open_goals(table)[0]))
    table.run_for(12.0)
    assert "did not answer" in table.header("prediction")["error"]
    assert hanging not in table.runtimes


def test_of_many_clicks_the_newest_is_asked_for_after_the_one_under_way(table: Table) -> None:
    play(table, steps=20)
    goals = open_goals(table)
    before = len(table.of("predictor/request"))
    for goal in goals[:30]:
        table.ask(requests.Predict(goal=goal))
    table.run(lambda: bool(table.frames("prediction")) and table.header("prediction")["goal"] == goals[29])
    assert [header["goal"] for header, _ in table.frames("prediction")] == [goals[0], goals[29]]
    assert len(table.of("predictor/request")) == before + 2


def test_a_console_that_missed_the_planners_question_says_so(table: Table) -> None:
    play(table, steps=20)
    goal = open_goals(table)[0]
    table.restart_console()
    table.come()
    table.settle()
    reason = table.header("hider/plan")["unpredictable"]
    assert "started after this game was planned" in reason
    table.ask(requests.Predict(goal=goal))
    table.settle()
    assert table.header("prediction")["error"] == reason
    play(table, steps=20)
    assert table.header("hider/plan")["unpredictable"] == ""


def test_a_hider_that_judges_no_goals_is_not_taken_for_one_whose_question_was_missed(table: Table) -> None:
    play(table, steps=20)
    plan = table.of("hider/plan")[-1]
    table.say("planner", [("hider/plan", replace(plan, values=(), goal=None))])
    assert "judges no goals" in table.header("hider/plan")["unpredictable"]


# Past views


def view(step: int, episode: int = 1) -> StateImage:
    return StateImage(stamp=step, episode=episode, step=step, data=bytes([step % 5]) * 128 * 128)


def test_past_views_are_those_of_the_present_game_and_do_not_grow() -> None:
    past = PastViews()
    for step in range(1000):
        past.add(view(step))
    assert len(past._views) == PastViews.LIMIT
    frames = [parse(data) for data in past.frames(requests.Views(episode=1, steps=(999, 600, 599, 5, 2000)))]
    assert [(header["key"], header["step"]) for header, _ in frames] == [("past/999", 999), ("past/600", 600)]
    assert frames[0][1] == view(999).data
    past.add(view(0, episode=2))
    assert not past.frames(requests.Views(episode=1, steps=(999,)))
    assert len(past.frames(requests.Views(episode=2, steps=(0, 1)))) == 1


def test_a_page_gets_the_views_it_asks_for(table: Table) -> None:
    play(table)
    table.ask(requests.Views(episode=table.of("episode")[-1].episode, steps=(0, 3, STEPS + 5)))
    table.settle()
    past = [(header, payload) for header, payload in table.pages.seen[1] if header["key"].startswith("past/")]
    assert [header["key"] for header, _ in past] == ["past/0", "past/3"]
    assert [payload for _, payload in past] == [table.of("seeker/view")[step].data for step in (0, 3)]
