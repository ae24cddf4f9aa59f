"""Measures of a yes-or-no prediction, and the predictors that need no network."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def area_under_roc(scores: NDArray[np.floating] | NDArray[np.integer], truth: NDArray[np.bool_]) -> float:
    """Return the chance that a true case scores higher than a false one, ties counted half; NaN for one class."""
    positives = int(truth.sum())
    negatives = len(truth) - positives
    if not positives or not negatives:
        return float("nan")
    _, inverse, counts = np.unique(scores, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - (counts - 1) / 2)[inverse]
    return float((ranks[truth].sum() - positives * (positives + 1) / 2) / (positives * negatives))


def accuracy(predicted: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    """Return the share of right answers."""
    return float((predicted == truth).mean())


def balanced_accuracy(predicted: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    """Return the mean of the shares of right answers among the true and among the false cases; NaN for one class."""
    if truth.all() or not truth.any():
        return float("nan")
    return float((predicted[truth].mean() + (~predicted[~truth]).mean()) / 2)


def bootstrap_interval(
    predicted: NDArray[np.bool_],
    truth: NDArray[np.bool_],
    episode: NDArray[np.integer],
    seed: int = 0,
    rounds: int = 2000,
    share: float = 0.95,
) -> tuple[float, float]:
    """Return the interval that holds `share` of the accuracies when episodes are drawn again (percentile cluster bootstrap).

    Examples of one episode share their catch, so that drawing single examples again would make the interval too narrow.

    Args:
        predicted, truth, episode: of each example. [B]
    """
    _, index = np.unique(episode, return_inverse=True)
    right = np.bincount(index, predicted == truth)  # right answers by episode
    count = np.bincount(index)
    generator = np.random.default_rng(seed)
    draws = generator.integers(len(count), size=(rounds, len(count)))
    means = right[draws].sum(axis=1) / count[draws].sum(axis=1)
    low, high = np.quantile(means, [(1 - share) / 2, (1 + share) / 2])
    return float(low), float(high)


def best_clock(caught_steps: NDArray[np.integer], horizons: int) -> int:
    """Return the horizon from which on "caught" is the best answer to make without looking: the most accurate threshold over
    all episodes and horizons 0 .. horizons - 1.

    Args:
        caught_steps: of each training episode, -1 for one survived. [E]
    """
    caught_by = np.zeros(horizons + 1, np.int64)
    for step in caught_steps[(caught_steps >= 0) & (caught_steps < horizons)]:
        caught_by[step] += 1
    caught_by = np.cumsum(caught_by)[:horizons]
    survived = len(caught_steps) - caught_by
    right = np.concatenate([[0], np.cumsum(survived)]) + np.concatenate([np.cumsum(caught_by[::-1])[::-1], [0]])
    return int(np.argmax(right))
