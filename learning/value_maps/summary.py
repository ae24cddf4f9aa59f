"""Mean, standard deviation and bootstrap interval over starts; differences paired by start."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from learning.accuracy.report import spread

ROUNDS = 2000
SHARE = 0.95


def interval_of_mean(values: NDArray[np.float64], seed: int = 0) -> tuple[float, float]:
    """Return the interval that holds 95 % of the means when starts are drawn again (percentile bootstrap); NaN left out.

    Args:
        values: of each start. [S]
    """
    known = values[~np.isnan(values)]
    if not len(known):
        return float("nan"), float("nan")
    draws = np.random.default_rng(seed).integers(len(known), size=(ROUNDS, len(known)))
    low, high = np.quantile(known[draws].mean(axis=1), [(1 - SHARE) / 2, (1 + SHARE) / 2])
    return float(low), float(high)


def summary(values: NDArray[np.float64], seed: int = 0) -> dict[str, float | list[float | None] | None]:
    """Return `mean`, `sd` (over starts, n - 1) and `interval 95 %` of the mean; starts where there is nothing to measure (NaN)
    are left out, and None stands where that leaves none.

    Args:
        values: of each start. [S]
    """
    known = values[~np.isnan(values)]
    return {
        "mean": _plain(known.mean()) if len(known) else None,
        "sd": _plain(known.std(ddof=1)) if len(known) > 1 else None,
        "interval 95 %": [_plain(bound) for bound in interval_of_mean(known, seed)],
        "starts": len(known),
    }


def over_seeds(values: NDArray[np.float64]) -> dict[str, Any]:
    """Return `over seeds` of a method that was trained with several: see `learning.accuracy.report.spread`; else nothing.

    Args:
        values: of each seed and start. [K, S]
    """
    known = values[:, ~np.isnan(values).any(axis=0)]
    return {"over seeds": spread(known.mean(axis=1).tolist())} if len(values) > 1 and known.size else {}


def _plain(number: float) -> float | None:
    """JSON knows no NaN."""
    return None if np.isnan(number) else float(number)
