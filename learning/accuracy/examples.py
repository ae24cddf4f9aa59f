"""Which examples every method is asked, and what can be said of them without looking at any."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from learning.dataset import Dataset, Samples
from learning.measures import fit_clock
from learning.splits import Split

Start = Literal["uniform", "first"]
"""Which step is t0: any before the catch (the paper's "uniform starting locations"), or the first (what the planner asks)."""
STARTS: tuple[Start, ...] = ("uniform", "first")

BLOCK = 1000
FITTED = 200_000
"""Training examples that the predictors without a network are fitted on."""


def draw_examples(data: Dataset, split: Split, count: int, start: Start, limit: int, seed: int) -> Samples:
    """Draw examples with horizons below `limit`, upright. A smaller count gives the first of a larger one's."""
    blocks = [
        data.draw(
            split,
            BLOCK,
            np.random.default_rng([seed, STARTS.index(start), limit, block]),
            from_start=float(start == "first"),
            horizon_limit=limit,
            symmetries=1,
        )
        for block in range(-(-count // BLOCK))
    ]
    columns = ("episode", "start", "horizon", "symmetry", "caught")
    return Samples(*(np.concatenate([getattr(block, column) for block in blocks])[:count] for column in columns))


def blind_logits(
    data: Dataset, examples: Samples, start: Start, limit: int, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.float32], int]:
    """Return what those say who look at nothing: logits [B] of always the same answer, logits [B] of the horizon alone, and the
    horizon from which on the latter says "caught". Both are fitted on training examples drawn as `examples` were."""
    fitted = draw_examples(data, "train", FITTED, start, limit, seed)
    clock = fit_clock(fitted.horizon, fitted.caught, limit)
    constant = np.full(len(examples), _logit(np.clip(fitted.caught.mean(), 1e-6, 1 - 1e-6)), np.float32)
    return constant, _logit(clock)[examples.horizon].astype(np.float32), int(np.searchsorted(clock, 0.5, side="right"))


def frequency_logits(share: NDArray[np.floating], simulations: int) -> NDArray[np.float32]:
    """Return the logits of shares of simulations [B], half a simulation added to either side so that none is certain."""
    return _logit((share * simulations + 0.5) / (simulations + 1.0)).astype(np.float32)


def _logit(probability: NDArray[np.floating]) -> NDArray[np.float64]:
    p = np.asarray(probability, np.float64)
    return np.log(p) - np.log1p(-p)
