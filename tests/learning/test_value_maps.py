"""Value maps: measures against their definitions, masked goals, choices, starts that nobody trained on."""

from __future__ import annotations

import json
import math
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from learning.evaluate_maps import EvaluateMapsSettings, main
from learning.methods.method import Questions
from learning.splits import SPLITS, split_of
from learning.value_maps.heuristics import HEURISTICS, seen_or_centre
from learning.value_maps.judged import maps_of, questions_of
from learning.value_maps.page import page_of
from learning.value_maps.play import BEST, OUTCOMES, UNIFORM, outcomes_of, play
from learning.value_maps.ranking import PAIRS, agreement
from learning.value_maps.report import ANOTHER, ONE_SIMULATION, arrays, ground_truths, heuristic_maps, mean_of, played, ranking
from learning.value_maps.summary import summary
from learning.value_maps.truth import Case, cases_of, counted, on_grid, seeds_of_test_split
from schemas import Rules
from services.planner.value_map import checkpoints, choose_goal
from vantage.errors import UserError
from vantage.output import AlreadyExists
from vantage.world.arena import GOALS


@st.composite
def maps(draw: st.DrawFn) -> NDArray[np.float64]:
    """[121], of few different values or of many: ties are common or rare."""
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    return generator.integers(draw(st.sampled_from([1, 2, 3, 20, 1000])), size=121) / 4


@st.composite
def blocked(draw: st.DrawFn) -> NDArray[np.bool_]:
    """[121], goals that are left out: none, some, nearly all or all."""
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    return generator.random(121) < draw(st.sampled_from([0.0, 0.3, 0.95, 1.0]))


def sign(number: float) -> int:
    return int(number > 0) - int(number < 0)


def pairs_by_definition(known: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Goals of every pair whose cells lie at least three cells apart."""
    return [
        (i, j) for i, j in combinations(range(121), 2) if known[i] and known[j] and math.dist(divmod(i, 11), divmod(j, 11)) >= 3
    ]


def test_pairs_are_those_at_least_three_cells_apart() -> None:
    found = sorted(zip(*PAIRS.tolist(), strict=True))
    assert found == pairs_by_definition(np.ones(121, np.bool_))
    assert all(math.dist(GOALS[i], GOALS[j]) > 0.3 - 1e-9 for i, j in found)


@settings(max_examples=20)
@given(predicted=maps(), truth=maps(), left_out=blocked())
def test_measures_are_what_a_loop_over_pairs_counts(
    predicted: NDArray[np.float64], truth: NDArray[np.float64], left_out: NDArray[np.bool_]
) -> None:
    true_map = np.where(left_out, np.nan, truth)
    orders = [(sign(predicted[i] - predicted[j]), sign(truth[i] - truth[j])) for i, j in pairs_by_definition(~left_out)]
    found = agreement(predicted, true_map)
    same, strict = [a == b for a, b in orders], [(a, b) for a, b in orders if b]
    half = [0.5 if a == 0 else float(a == b) for a, b in strict]
    product = sum(a * b for a, b in orders)
    scale = math.sqrt(len(strict) * sum(a != 0 for a, _ in orders))
    expected = {
        "with_ties": sum(same) / len(same) if same else math.nan,
        "without_ties": sum(a == b for a, b in strict) / len(strict) if strict else math.nan,
        "ties_half": sum(half) / len(half) if half else math.nan,
        "tau_b": product / scale if scale else math.nan,
        "tied": sum(b == 0 for _, b in orders) / len(orders) if orders else math.nan,
        "predicted_tied": sum(a == 0 for a, _ in orders) / len(orders) if orders else math.nan,
    }
    for name, value in expected.items():
        assert getattr(found, name) == pytest.approx(value, nan_ok=True), name


@given(truth=maps(), left_out=blocked())
def test_the_truth_agrees_with_itself_and_its_reverse_with_nothing_but_ties(
    truth: NDArray[np.float64], left_out: NDArray[np.bool_]
) -> None:
    true_map = np.where(left_out, np.nan, truth)
    perfect, reversed_ = agreement(2 * truth + 5, true_map), agreement(-truth, true_map)
    if not math.isnan(perfect.tau_b):
        assert perfect.with_ties == perfect.without_ties == perfect.ties_half == 1
        assert perfect.tau_b == pytest.approx(1)
        assert reversed_.without_ties == reversed_.ties_half == 0
        assert reversed_.tau_b == pytest.approx(-1)
        assert reversed_.with_ties == pytest.approx(perfect.tied)


def test_a_constant_map_is_right_about_ties_alone() -> None:
    truth = np.repeat([0.0, 1.0], [60, 61])
    found = agreement(np.zeros(121), truth)
    assert (found.with_ties, found.without_ties, found.ties_half) == (pytest.approx(found.tied), 0, 0.5)
    assert math.isnan(found.tau_b)


def test_blocked_goals_do_not_count_and_lacking_ones_are_noticed() -> None:
    truth = np.arange(121.0)
    truth[50:] = np.nan
    predicted = np.where(np.arange(121) < 50, truth, 7.0)
    predicted[60] = np.nan
    assert agreement(predicted, truth).with_ties == 1
    predicted[3] = np.nan
    with pytest.raises(ValueError, match="lacks goals"):
        agreement(predicted, truth)
    assert math.isnan(agreement(np.zeros(121), np.full(121, np.nan)).with_ties)


@given(caught=st.lists(st.integers(-1, 60), min_size=1, max_size=8), horizon=st.integers(10, 60))
def test_value_counts_the_checkpoints_that_find_the_hider_caught(caught: list[int], horizon: int) -> None:
    steps = checkpoints(horizon, 10)
    assert counted(np.array(caught, np.int32), horizon).tolist() == [sum(0 <= c <= t for t in steps) for c in caught]


def test_starts_are_of_the_test_split_and_no_seed_comes_twice() -> None:
    seeds = seeds_of_test_split(5, 200)
    assert len(set(seeds)) == 200
    assert {SPLITS[split_of(seed)] for seed in seeds} == {"test"}
    assert seeds_of_test_split(5, 50) == seeds[:50]
    assert not set(seeds) & set(seeds_of_test_split(6, 200))


def test_heuristics_prefer_what_they_say() -> None:
    hider, seeker = (0.2, 0.2), (1.0, 0.2)
    far = HEURISTICS["far from the seeker"](hider, seeker)
    late = HEURISTICS["distance to seeker minus distance to hider"](hider, seeker)
    assert GOALS[np.argmin(far)].tolist() == pytest.approx([0.1, 1.1])
    assert late[0] == pytest.approx(math.dist((0.1, 0.1), hider) - math.dist((0.1, 0.1), seeker))
    halfway = int(np.flatnonzero((abs(GOALS - [0.6, 0.7]) < 1e-9).all(axis=1))[0])
    assert late[halfway] == pytest.approx(0)
    assert seen_or_centre(None) == (0.6, 0.6)
    assert seen_or_centre(seeker) == seeker


def made_up_case(caught: NDArray[np.int32], goals: NDArray[np.int64], seed: int = 3) -> Case:
    """A start whose outcomes are given, with straight paths to its goals."""
    hider = np.array([0.15, 0.15])
    way = np.linspace(0, 1, 201)[None, :, None]
    places = hider + way * (GOALS[goals][:, None] - hider)
    paths = np.concatenate([places, np.zeros((len(goals), 201, 1))], axis=2).astype(np.float32)
    poses = np.array([[*hider, 0.0], [0.5, 0.15, 18.0]])
    view = np.full((128, 128), seed % 5, np.uint8)
    free = np.arange(len(goals)) % 3 > 0
    return Case(seed, np.empty((0, 7)), poses, view, (0.5, 0.15), goals, free, paths, caught, caught[:, :0])


GOAL_NUMBERS = np.array([0, 5, 10, 60, 110, 115, 120], np.int64)


def test_outcomes_are_means_over_simulations() -> None:
    caught = np.array([[-1, 50, 101, 250], [9, 10, 200, 201]], np.int32)
    found = dict(zip(OUTCOMES, outcomes_of(caught, 250).T.tolist(), strict=True))
    assert found["survival"] == [(250 + 50 + 101 + 250) / 4, (9 + 10 + 200 + 201) / 4]
    assert found["caught by 100"] == [1 / 4, 2 / 4]
    assert found["caught by 200"] == [2 / 4, 3 / 4]
    assert found["caught by T"] == [3 / 4, 1]
    assert found["V"] == [(0 + 20 + 15 + 0) / 4, (25 + 24 + 5 + 5) / 4]
    shorter = dict(zip(OUTCOMES, outcomes_of(caught, 60).T.tolist(), strict=True))
    assert shorter["survival"] == [(60 + 50 + 60 + 60) / 4, (9 + 10 + 60 + 60) / 4]
    assert shorter["caught by 100"] == shorter["caught by T"]


def test_play_scores_the_goal_that_the_map_chooses() -> None:
    caught = np.full((len(GOAL_NUMBERS), 5), 20, np.int32)
    caught[3] = -1  # goal 60 is safe
    caught[:, 0] = 10  # the episode's own simulation is no part of the score
    case = made_up_case(caught, GOAL_NUMBERS)
    safe, tied = np.full(121, np.nan), np.full(121, np.nan)
    safe[GOAL_NUMBERS] = [5, 5, 5, 4, 5, 5, 5]
    tied[GOAL_NUMBERS] = 1
    fared = {
        name: dict(zip(OUTCOMES, row.tolist(), strict=True)) for name, row in play(case, {"s": safe, "t": tied}, 100).items()
    }
    assert fared["s"] == fared[BEST] == {"V": 0, "survival": 100, "caught by 100": 0, "caught by 200": 0, "caught by T": 0}
    assert choose_goal(tied, *case.hider) == 120  # ties go to the farthest
    assert fared["t"]["survival"] == 20
    assert fared[UNIFORM]["survival"] == pytest.approx((6 * 20 + 100) / 7)


def test_the_best_goal_gains_nothing_from_luck() -> None:
    """All goals are alike here: chosen and scored on the same games the best of them would look good."""
    generator = np.random.default_rng(1)
    goals = np.arange(121)
    gains = []
    for _ in range(60):
        case = made_up_case(generator.integers(1, 200, (121, 9)).astype(np.int32), goals)
        fared = play(case, {}, 200)
        gains.append(fared[BEST][1] - fared[UNIFORM][1])
    assert abs(np.mean(gains)) < 4 * np.std(gains) / math.sqrt(len(gains))
    assert outcomes_of(case.caught[:, 1:], 200)[:, 1].max() - fared[UNIFORM][1] > 30  # how good it would have looked


class Omniscient:
    """Answers from the outcomes of made-up cases, known by their views; remembers what it was asked."""

    name = "omniscient"

    def __init__(self, cases: list[Case]) -> None:
        self.cards: dict[str, Any] = {}
        self.cases = {case.view.tobytes(): case for case in cases}
        self.asked: list[Questions] = []

    def judge(self, questions: Questions) -> NDArray[np.float32]:
        self.asked.append(questions)
        case = self.cases[questions.views[0].tobytes()]
        steps = case.caught[questions.first // case.paths.shape[1], 0]
        return np.where((steps >= 0) & (steps <= questions.horizons), 30, -2).astype(np.float32)


def some_cases(count: int = 4) -> list[Case]:
    generator = np.random.default_rng(7)
    return [
        made_up_case(generator.integers(-1, 60, (len(GOAL_NUMBERS), 7)).astype(np.int32), GOAL_NUMBERS, seed)
        for seed in range(count)
    ]


def test_questions_ask_about_every_goal_at_every_checkpoint_of_its_own_plan() -> None:
    case = some_cases(1)[0]
    asked = questions_of(case, 50)
    assert asked.horizons.reshape(len(GOAL_NUMBERS), -1).tolist() == [[9, 19, 29, 39, 49]] * len(GOAL_NUMBERS)
    ends = asked.positions[asked.last].reshape(len(GOAL_NUMBERS), -1, 3)
    assert np.allclose(ends[:, :, :2], GOALS[GOAL_NUMBERS][:, None], atol=1e-6)  # the whole plan, to the goal
    assert np.allclose(asked.positions[asked.first, :2], case.hider)


def test_a_method_that_knows_everything_has_the_true_map() -> None:
    cases = some_cases()
    method = Omniscient(cases)
    for case in cases:
        found = maps_of(method, case, (50, 20))
        for h, horizon in enumerate((50, 20)):
            truth = on_grid(case.goals, counted(case.caught[:, 0], horizon))
            assert np.array_equal(found["binary"][h], truth, equal_nan=True)
            doubt = len(checkpoints(horizon, 10)) - truth  # answered with a logit of -2 each
            assert found["expected"][h] == pytest.approx(truth + doubt / (1 + math.exp(2)), nan_ok=True)
        assert np.isnan(found["binary"]).sum() == 2 * (121 - len(GOAL_NUMBERS))


def results(cases: list[Case], horizons: tuple[int, ...] = (30, 60)) -> dict[str, Any]:
    method = Omniscient(cases)
    found = [maps_of(method, case, horizons) for case in cases]
    maps = {f"vpt-tob, {value}": np.stack([each[value] for each in found]) for value in ("binary", "expected")}
    maps |= heuristic_maps(cases, horizons)
    return {
        "ranking": ranking(cases, horizons, maps, "vpt-tob", 1),
        "ranking of free goals": ranking(cases, horizons, maps, "vpt-tob", 1, free_only=True),
        "play": played(cases, horizons, maps, "vpt-tob", 1),
        "arrays": arrays(cases, horizons, maps),
        "maps": maps,
    }


def test_the_report_ranks_every_predictor_against_both_truths() -> None:
    cases = some_cases()
    found = results(cases)
    one = found["ranking"]["60"][ONE_SIMULATION]
    assert one["vpt-tob, binary"]["with_ties"]["mean"] == 1
    assert one["vpt-tob, binary"]["with_ties"]["difference"]["mean"] == 0
    assert one["vpt-tob, binary"]["with_ties"]["change since the first horizon"]["mean"] == 0
    assert "change since the first horizon" not in found["ranking"]["30"][ONE_SIMULATION][ANOTHER]["with_ties"]
    by_hand = [
        agreement(*(on_grid(case.goals, counted(case.caught[:, column], 60)) for column in (1, 0))).without_ties for case in cases
    ]
    assert one[ANOTHER]["without_ties"]["mean"] == pytest.approx(np.nanmean(by_hand))
    assert one[ANOTHER]["without_ties"]["sd"] == pytest.approx(np.nanstd(by_hand, ddof=1))
    expected = one["vpt-tob, expected"]["without_ties"]["mean"]
    assert one[ANOTHER]["without_ties"]["difference"]["mean"] == pytest.approx(np.nanmean(by_hand) - expected)
    mean = found["ranking"]["60"][mean_of(6)]
    assert set(mean) == {*found["maps"], "vpt-tob, rounded", ANOTHER}
    assert mean["vpt-tob, rounded"]["predicted_tied"]["mean"] > mean["vpt-tob, expected"]["predicted_tied"]["mean"]
    truth = ground_truths(cases, (60,))[mean_of(6)][0, 0]
    assert truth[GOAL_NUMBERS] == pytest.approx(counted(cases[0].caught[:, 1:], 60).mean(axis=1))


def test_play_is_compared_with_the_goal_that_probabilities_choose() -> None:
    cases = some_cases()
    fared = results(cases)["play"]["60"]
    for name in ("vpt-tob, binary", UNIFORM, BEST):
        difference = fared[name]["V"]["mean"] - fared["vpt-tob, expected"]["V"]["mean"]
        assert fared[name]["V"]["difference"]["mean"] == pytest.approx(difference), name


def test_free_goals_alone_are_ranked_beside() -> None:
    case = some_cases(1)[0]
    found = results([case])["ranking of free goals"]["60"][ONE_SIMULATION]["far from the seeker"]["with_ties"]["mean"]
    truth = on_grid(case.goals[case.free], counted(case.caught[case.free, 0], 60))
    assert found == agreement(HEURISTICS["far from the seeker"](case.hider, (0.5, 0.15)), truth).with_ties


def test_arrays_hold_what_figures_need() -> None:
    cases = some_cases()
    found = results(cases)["arrays"]
    assert found["caught"].shape == (4, 121, 7)
    assert (found["caught"][:, GOAL_NUMBERS] >= -1).all() and (np.delete(found["caught"], GOAL_NUMBERS, axis=1) == -2).all()
    assert np.array_equal(found["proposed"], ~np.isnan(found["truth"][:, 0]))
    for p, s, h in np.ndindex(*found["chosen"].shape):
        values = found["values"][p, s, h]
        assert values[found["chosen"][p, s, h]] == np.nanmin(values)


def test_a_summary_leaves_out_what_could_not_be_measured() -> None:
    found = summary(np.array([1.0, 2.0, math.nan, 3.0]))
    assert (found["mean"], found["sd"], found["starts"]) == (2, 1, 3)
    assert summary(np.array([math.nan]))["mean"] is None
    values = np.random.default_rng(2).normal(5, 1, 400)
    low, high = summary(values)["interval 95 %"]  # type: ignore[misc]
    assert (high - low) / 2 == pytest.approx(1.96 * values.std() / 20, rel=0.1)
    json.dumps(summary(np.full(2, math.nan)), allow_nan=False)


def test_real_starts_come_out_the_same_whatever_the_number_of_threads() -> None:
    rules = Rules(maximum_steps=40)
    one, two = (list(cases_of(seeds_of_test_split(1, 2), rules, "glancing", 2, workers)) for workers in (1, 2))
    for case, again in zip(one, two, strict=True):
        assert case.seed == again.seed
        assert case.caught.shape == (len(case.goals), 3)
        assert np.array_equal(case.caught, again.caught)
        assert np.array_equal(case.paths, again.paths)
        assert case.paths.shape == (len(case.goals), 201, 3)
        assert ((case.caught == -1) | ((case.caught >= 1) & (case.caught <= 40))).all()
        assert 2 < case.free.sum() <= len(case.goals)
        assert case.seeker is not None
        assert math.dist(case.seeker, case.poses[1, :2]) < 0.05
        assert np.allclose(case.paths[:, 0, :2], case.hider)


def test_the_page_shows_the_paper_beside_every_predictor() -> None:
    cases = some_cases()
    found = results(cases, (200,))
    machine = {"cpu": "a processor", "cores": 2, "memory GiB": 4, "gpus": []}
    origin = {"command": "vantage evaluate maps", "commit": "c", "when": "now", "hardware": machine, "torch": "2"}
    report = {
        **{key: found[key] for key in ("ranking", "ranking of free goals", "play")},
        "provenance": origin,
        "horizons": [200],
        "ground truths": list(ground_truths(cases, (200,))),
        "starts": [1, 2],
        "seed": 1,
        "seeker": "glancing",
        "layout": "random",
        "simulations": 6,
        "goals per map": 7.0,
        "free goals per map": 4.0,
        "against": "vpt-tob",
        "seconds per map": {"vpt-tob": 1.25},
    }
    page = page_of(json.loads(json.dumps(report, allow_nan=False)))
    assert "| the paper | 75.29 ± 12.23 |" in page
    assert "| vpt-tob, binary | 100.00 ± 0.00 [100.0, 100.0] |" in page
    assert "| vpt-tob | 1.25 |" in page
    for name in (*found["maps"], UNIFORM, BEST, ANOTHER):
        assert f"| {name} |" in page


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (EvaluateMapsSettings(methods=("oracle-of-delphi",)), "the table has"),
        (EvaluateMapsSettings(methods=()), "names no method"),
        (EvaluateMapsSettings(simulations=1), "--simulations must be at least 2"),
        (EvaluateMapsSettings(horizons=(200, 5)), "at least 10 steps"),
        (EvaluateMapsSettings(starts=0), "--starts"),
        (EvaluateMapsSettings(weights=Path("/nowhere")), "no method has its weights in /nowhere"),
    ],
)
def test_mistakes_are_answered_in_one_readable_text(settings: EvaluateMapsSettings, told: str) -> None:
    with pytest.raises(UserError, match=told):
        main(settings)


def test_results_are_named_in_full_and_not_replaced_without_force(tmp_path: Path) -> None:
    (tmp_path / "maps.v2.npz").touch()
    asked = EvaluateMapsSettings(weights=Path("weights"), starts=1, to=tmp_path / "maps.v2")
    with pytest.raises(AlreadyExists, match=r"maps\.v2\.npz exists already: choose another --to.*--force"):
        main(asked)
