"""From conditional hazards at checkpoints to "caught by any step"."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

TAIL = 5
"""Checkpoints whose mean conditional hazard goes on beyond the last one."""
CERTAIN = 20.0
"""Largest logit: e^-20 is nearer to nothing than any estimate here."""


def caught_logits(conditional: NDArray[np.floating], horizons: NDArray[np.integer], spacing: int = 10) -> NDArray[np.float32]:
    """Return the logit of "caught by `horizons[b]` steps from now" [B]; never falls as the horizon grows.

    Checkpoint k = 1 .. K lies k * spacing - 1 steps from now. The logarithm of survival is zero now, linear between
    checkpoints (a constant chance a step), and goes on beyond the last one with the mean conditional hazard of the last
    `TAIL`: networks trained on at most K * spacing steps are asked for longer horizons (paper, Table II).

    Args:
        conditional: logits of being caught at checkpoint k, not having been caught before it. [B, K]
        horizons: steps. [B]
    """
    logits = np.asarray(conditional, np.float64)
    count, checkpoints = logits.shape
    escape = -np.logaddexp(0.0, logits)  # log(1 - hazard) [B, K]
    survival = np.concatenate([np.zeros((count, 1)), np.cumsum(escape, axis=1)], axis=1)  # [B, K + 1]
    steps = np.concatenate([[0.0], np.arange(1, checkpoints + 1) * spacing - 1.0])  # [K + 1]
    at = np.asarray(horizons, np.float64)
    left = np.clip(np.searchsorted(steps, at, side="right") - 1, 0, checkpoints - 1)
    rows = np.arange(count)
    within = np.minimum((at - steps[left]) / (steps[left + 1] - steps[left]), 1.0)
    total = survival[rows, left] + within * (survival[rows, left + 1] - survival[rows, left])
    tail = np.log1p(-np.minimum(_sigmoid(logits[:, -TAIL:]).mean(axis=1), 1.0 - 1e-12))
    total += np.maximum(at - steps[-1], 0.0) / spacing * tail
    with np.errstate(divide="ignore"):
        return np.clip(np.log(-np.expm1(total)) - total, -CERTAIN, CERTAIN).astype(np.float32)


def _sigmoid(logits: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.exp(-np.logaddexp(0.0, -logits))
