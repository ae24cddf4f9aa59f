"""Relative ranking accuracy (paper, Table II): do two maps agree on which of two goals is more dangerous?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vantage.world.arena import GOAL_COLUMNS

APART = 3
"""Cells between the goals of a pair, at least (Euclidean; reading of the paper, row 18)."""


def _pairs_apart(cells: int) -> NDArray[np.int64]:
    goal = np.arange(GOAL_COLUMNS**2)
    first, second = np.triu_indices(len(goal), 1)
    up = first // GOAL_COLUMNS - second // GOAL_COLUMNS
    across = first % GOAL_COLUMNS - second % GOAL_COLUMNS
    far = across**2 + up**2 >= cells**2
    return np.stack([first[far], second[far]])


PAIRS = _pairs_apart(APART)  # int64 [2, P]: goals of every pair


@dataclass(frozen=True)
class Agreement:
    """How well the order of goals in one map agrees with another's, over pairs of goals that both maps have.

    Attributes:
        with_ties: share of pairs for which sign(Vi - Vj) is the same in both maps, equality included (the paper's measure).
        without_ties: the same over pairs that differ in the ground truth; a predicted tie is wrong.
        ties_half: as `without_ties`, but a predicted tie is half right, as a coin would decide it.
        tau_b: Kendall's tau-b over these pairs.
        tied: share of pairs that are equal in the ground truth.
        predicted_tied: share of pairs that are equal in the prediction.

    NaN where there is no pair to judge.
    """

    with_ties: float
    without_ties: float
    ties_half: float
    tau_b: float
    tied: float
    predicted_tied: float


def agreement(predicted: NDArray[np.float64], truth: NDArray[np.float64]) -> Agreement:
    """Return how well two maps agree. Where the truth is NaN, the goal is blocked and left out.

    Args:
        predicted, truth: V, the danger of each goal. [121]

    Raises:
        ValueError: a goal has a true value and no predicted one.
    """
    known = ~np.isnan(truth)
    if np.isnan(predicted[known]).any():
        raise ValueError("the predicted map lacks goals that the true one has")
    first, second = PAIRS[:, known[PAIRS[0]] & known[PAIRS[1]]]
    if not len(first):
        return Agreement(*[math.nan] * 6)
    true_order = np.sign(truth[first] - truth[second])
    order = np.sign(predicted[first] - predicted[second])
    differ, predicted_differ = true_order != 0, order != 0
    product = true_order * order
    count, strict = len(first), int(differ.sum())
    concordant, discordant = int((product > 0).sum()), int((product < 0).sum())
    ties_half = (concordant + 0.5 * int((differ & ~predicted_differ).sum())) / strict if strict else math.nan
    scale = math.sqrt(strict * int(predicted_differ.sum()))
    return Agreement(
        with_ties=float((true_order == order).mean()),
        without_ties=concordant / strict if strict else math.nan,
        ties_half=ties_half,
        tau_b=(concordant - discordant) / scale if scale else math.nan,
        tied=1 - strict / count,
        predicted_tied=1 - int(predicted_differ.sum()) / count,
    )
