"""Measures of a yes-or-no prediction, and the predictor that knows the horizon alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

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


def measures_of_logits(scores: NDArray[np.floating], caught: NDArray[np.bool_]) -> dict[str, float]:
    """Return what a training tells of the logits of "caught" [N]: `loss` is the negative log-likelihood."""
    return {
        "loss": float(np.logaddexp(0.0, np.where(caught, -scores, scores)).mean()),
        "accuracy": accuracy(scores > 0, caught),
        "balanced accuracy": balanced_accuracy(scores > 0, caught),
        "AUROC": area_under_roc(scores, caught),
    }


def clustered_interval(
    values: NDArray[np.floating] | NDArray[np.integer] | NDArray[np.bool_],
    cluster: NDArray[np.integer],
    seed: int = 0,
    rounds: int = 2000,
    share: float = 0.95,
) -> tuple[float, float]:
    """Return the interval that holds `share` of the means when clusters are drawn again (percentile cluster bootstrap).

    Examples of one episode share their catch, so that drawing single examples again would make the interval too narrow. For the
    accuracy of a method `values` are its right answers; for a paired difference, the differences of two methods' right answers.

    Args:
        values, cluster: of each example. [B]
    """
    _, index = np.unique(cluster, return_inverse=True)
    total, count = np.bincount(index, values).astype(np.float32), np.bincount(index).astype(np.float32)  # by cluster
    times = _times_drawn(len(count), rounds, seed)
    means = np.einsum("rc,c->r", times, total) / np.einsum("rc,c->r", times, count)  # `@` would wait for threads on busy cores
    low, high = np.quantile(means, [(1 - share) / 2, (1 + share) / 2])
    return float(low), float(high)


@lru_cache(maxsize=32)
def _times_drawn(clusters: int, rounds: int, seed: int) -> NDArray[np.float32]:
    """Return how often each round draws each cluster, [rounds, clusters]; the same for all that are compared."""
    generator = np.random.default_rng(seed)
    return generator.multinomial(clusters, np.full(clusters, 1.0 / clusters), size=rounds).astype(np.float32)


def bootstrap_interval(
    predicted: NDArray[np.bool_], truth: NDArray[np.bool_], episode: NDArray[np.integer], seed: int = 0
) -> tuple[float, float]:
    """Return the 95 % interval of the accuracy when episodes are drawn again; see `clustered_interval`. All [B]."""
    return clustered_interval(predicted == truth, episode, seed)


@dataclass(frozen=True)
class Calibration:
    """How far the probabilities may be taken at their word.

    Attributes:
        error: expected calibration error: the mean distance of probability and share over the bins, by examples.
        brier: mean squared error of the probability.
        log_loss: mean of minus the logarithm of the probability of what happened, in nats.
        bins: (mean probability, share of true cases, examples) of bins with equally many examples, by rising probability.
    """

    error: float
    brier: float
    log_loss: float
    bins: list[tuple[float, float, int]]


def calibration(logits: NDArray[np.floating], truth: NDArray[np.bool_], bins: int = 10) -> Calibration:
    """Return the calibration of the probabilities that logits [B] stand for.

    Examples of the same logit count as equally often true each, so that it does not matter in which order a bin cuts them.
    """
    z = np.asarray(logits, np.float64)
    probability = np.exp(-np.logaddexp(0.0, -z))
    _, inverse, counts = np.unique(z, return_inverse=True, return_counts=True)
    share = (np.bincount(inverse, truth) / counts)[inverse]
    parts = [part for part in np.array_split(np.argsort(z, kind="stable"), bins) if len(part)]
    found = [(float(probability[part].mean()), float(share[part].mean()), len(part)) for part in parts]
    return Calibration(
        error=sum(abs(told - true) * count for told, true, count in found) / len(z),
        brier=float(np.square(probability - truth).mean()),
        log_loss=float(np.logaddexp(0.0, np.where(truth, -z, z)).mean()),
        bins=found,
    )


def fit_clock(horizons: NDArray[np.integer], caught: NDArray[np.bool_], limit: int) -> NDArray[np.float64]:
    """Return the best that can be said without looking: the probability of "caught" at horizons 0 .. limit - 1, [limit].

    It never falls as the horizon grows (isotonic regression by pooling adjacent violators), and is above one half from the very
    step on from which saying "caught" is right most often among these examples.

    Args:
        horizons, caught: of training examples; horizons below `limit`. [B]
    """
    counts = np.bincount(horizons, minlength=limit)
    caught_counts = np.bincount(horizons, caught, minlength=limit)
    pools: list[tuple[float, int, int]] = []  # caught, examples, steps
    for step in range(limit):
        pool = (float(caught_counts[step]), int(counts[step]), 1)
        while pools and (pool[1] == 0 or pools[-1][1] == 0 or pools[-1][0] * pool[1] >= pool[0] * pools[-1][1]):
            before = pools.pop()
            pool = (before[0] + pool[0], before[1] + pool[1], before[2] + pool[2])
        pools.append(pool)
    probability = np.concatenate([np.full(steps, (c + 0.5) / (n + 1.0)) for c, n, steps in pools])
    return np.maximum.accumulate(probability)
