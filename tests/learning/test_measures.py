"""Measures against their definitions."""

from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.measures import (
    accuracy,
    area_under_roc,
    balanced_accuracy,
    bootstrap_interval,
    calibration,
    clustered_interval,
    fit_clock,
)

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
@given(found=st.lists(st.tuples(st.integers(0, 7), st.booleans()), min_size=1, max_size=40), limit=st.integers(8, 10))
def test_the_clock_is_as_often_right_as_the_best_threshold(found: list[tuple[int, bool]], limit: int) -> None:
    horizons, caught = np.array([horizon for horizon, _ in found]), np.array([truth for _, truth in found])
    clock = fit_clock(horizons, caught, limit)
    assert len(clock) == limit and (np.diff(clock) >= 0).all() and (clock > 0).all() and (clock < 1).all()
    right = ((clock[horizons] > 0.5) == caught).sum()
    assert right == max((caught == (horizons >= threshold)).sum() for threshold in range(limit + 1))


def test_the_clock_tells_the_shares_where_they_rise() -> None:
    horizons = np.repeat(np.arange(4), 1000)
    share = np.array([0.1, 0.5, 0.4, 0.9])  # the middle two are pooled
    caught = np.tile(np.arange(1000) / 1000, 4) < share[horizons]
    np.testing.assert_allclose(fit_clock(horizons, caught, 4), [0.1, 0.45, 0.45, 0.9], atol=1e-3)


scored = st.lists(st.tuples(st.integers(-4, 4), st.booleans()), min_size=1, max_size=60)


@given(scored, st.randoms(use_true_random=False))
def test_calibration_by_its_definition_and_in_any_order(found: list[tuple[int, bool]], random: Random) -> None:
    z, truth = np.array([score for score, _ in found], float), np.array([caught for _, caught in found])
    p = 1 / (1 + np.exp(-z))
    measured = calibration(z, truth)
    assert measured.brier == pytest.approx(np.mean((p - truth) ** 2))
    assert measured.log_loss == pytest.approx(-np.mean(np.log(np.where(truth, p, 1 - p))))
    counts = [count for _, _, count in measured.bins]
    assert sum(counts) == len(z) and max(counts) - min(counts) <= 1 and len(counts) <= 10
    assert sum(share * count for _, share, count in measured.bins) == pytest.approx(truth.sum())
    told = [probability for probability, _, _ in measured.bins]
    assert told == sorted(told)
    assert measured.error == pytest.approx(sum(abs(a - b) * n for a, b, n in measured.bins) / len(z))
    order = list(range(len(z)))
    random.shuffle(order)
    assert calibration(z[order], truth[order]).error == pytest.approx(measured.error)


def test_probabilities_that_come_true_as_often_as_they_say_are_calibrated() -> None:
    generator = np.random.default_rng(0)
    z = generator.normal(size=100_000) * 2
    truth = generator.random(len(z)) < 1 / (1 + np.exp(-z))
    assert calibration(z, truth).error < 0.01
    assert calibration(3 * z, truth).error > 0.1


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


def test_a_paired_difference_is_drawn_again_by_episode_too() -> None:
    generator = np.random.default_rng(1)
    episode = np.repeat(np.arange(200), 10)
    gain = np.repeat(generator.choice([-1.0, 0.0, 1.0], 200, p=[0.1, 0.7, 0.2]), 10)
    low, high = clustered_interval(gain, episode)
    means = gain.reshape(200, 10).mean(axis=1)  # equally long: the interval of the clusters' means
    assert (high - low) / 2 == pytest.approx(1.96 * means.std() / np.sqrt(200), rel=0.1)
    assert low < gain.mean() < high
