"""Measures against their definitions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.measures import accuracy, area_under_roc, balanced_accuracy, best_clock, bootstrap_interval

cases = st.lists(st.tuples(st.integers(-3, 3), st.booleans()), min_size=1, max_size=30)


@given(cases)
def test_area_under_roc_is_the_share_of_pairs_in_the_right_order(found: list[tuple[int, bool]]) -> None:
    scores, truth = np.array([score for score, _ in found], float), np.array([caught for _, caught in found])
    pairs = [(a > b) + 0.5 * (a == b) for a in scores[truth] for b in scores[~truth]]
    assert area_under_roc(scores, truth) == pytest.approx(np.mean(pairs) if pairs else np.nan, nan_ok=True)


@given(cases)
def test_accuracies_are_shares_of_right_answers(found: list[tuple[int, bool]]) -> None:
    predicted, truth = np.array([score > 0 for score, _ in found]), np.array([caught for _, caught in found])
    assert accuracy(predicted, truth) == pytest.approx(sum(a == b for a, b in zip(predicted, truth, strict=True)) / len(found))
    if truth.any() and not truth.all():
        assert balanced_accuracy(np.ones_like(truth), truth) == 0.5
        assert balanced_accuracy(truth, truth) == 1.0


@settings(max_examples=60)
@given(steps=st.lists(st.integers(-1, 12), min_size=1, max_size=15), horizons=st.integers(1, 10))
def test_the_best_clock_beats_every_other_threshold(steps: list[int], horizons: int) -> None:
    caught = np.array([[0 <= step <= horizon for horizon in range(horizons)] for step in steps])

    def right(threshold: int) -> int:
        return int((caught == (np.arange(horizons) >= threshold)).sum())

    assert right(best_clock(np.array(steps), horizons)) == max(right(threshold) for threshold in range(horizons + 1))


def test_examples_of_one_episode_are_drawn_together() -> None:
    truth = np.arange(1000) < 800
    alone = bootstrap_interval(np.ones(1000, np.bool_), truth, np.arange(1000))
    together = bootstrap_interval(np.ones(1000, np.bool_), truth, np.arange(1000) // 10)
    assert together[1] - together[0] > 2.5 * (alone[1] - alone[0])


def test_the_bootstrap_interval_has_the_width_of_the_binomial() -> None:
    truth = np.arange(1000) < 800
    low, high = bootstrap_interval(np.ones(1000, np.bool_), truth, np.arange(1000))
    assert low == pytest.approx(0.8 - 1.96 * np.sqrt(0.16 / 1000), abs=0.005)
    assert high == pytest.approx(0.8 + 1.96 * np.sqrt(0.16 / 1000), abs=0.005)
