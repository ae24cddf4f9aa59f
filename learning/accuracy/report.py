"""What is said of methods that judged the same examples, as it stands in the JSON."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from learning.dataset import Dataset, Samples
from learning.measures import accuracy, area_under_roc, balanced_accuracy, bootstrap_interval, calibration, clustered_interval

CLOCK = "horizon only"
MAJORITY = "majority class"
ORACLE = "oracle"
"""Plays games on from their true state."""
VIEW_ORACLE = "view oracle"
"""Plays games on in all arenas that look the same to the hider: what can be known from its view."""
REFERENCES = (CLOCK, "vpt-tob")
"""What every method is compared with, example by example."""
BIN = 20
"""Steps of a bin of horizons."""


def judged(logits: dict[str, NDArray[np.float32]], data: Dataset, examples: Samples, seed: int) -> dict[str, Any]:
    """Return what is to be said of every method, by its name, on the first examples that each has judged.

    Keys: `examples`, `accuracy`, `accuracy interval 95 %` (episodes drawn again), `balanced accuracy`, `AUROC`, `calibration`
    (`expected calibration error`, `Brier`, `log loss`, `bins`), `against` (by reference: `difference` of accuracies and its
    `interval 95 %`), `by horizon` and `by hider` (`examples`, `caught share`, `accuracy`, `interval 95 %`).

    Args:
        logits: of "caught", by method; a method may have judged fewer than all examples. [B] or shorter
    """
    return {name: _one(name, found, logits, data, examples.part(0, len(found)), seed) for name, found in logits.items()}


def _one(
    name: str, found: NDArray[np.float32], logits: dict[str, NDArray[np.float32]], data: Dataset, examples: Samples, seed: int
) -> dict[str, Any]:
    truth, said, episode = examples.caught, found > 0, examples.episode
    right = said == truth
    against = {}
    for reference in REFERENCES:
        if reference != name and len(logits.get(reference, ())) >= len(found):
            gain = right.astype(float) - ((logits[reference][: len(found)] > 0) == truth)
            against[reference] = {
                "difference": float(gain.mean()),
                "interval 95 %": list(clustered_interval(gain, episode, seed)),
            }
    measured = calibration(found, truth)

    def part(mine: NDArray[np.bool_]) -> dict[str, Any]:
        return {
            "examples": int(mine.sum()),
            "caught share": float(truth[mine].mean()),
            "accuracy": float(right[mine].mean()),
            "interval 95 %": list(bootstrap_interval(said[mine], truth[mine], episode[mine], seed)),
        }

    hider = data.episodes["hider"][episode]
    starts = range(0, int(examples.horizon.max()) + 1, BIN)
    bins = {f"{first}..{first + BIN - 1}": examples.horizon // BIN == first // BIN for first in starts}
    return {
        "examples": len(found),
        "accuracy": accuracy(said, truth),
        "accuracy interval 95 %": list(bootstrap_interval(said, truth, episode, seed)),
        "balanced accuracy": balanced_accuracy(said, truth),
        "AUROC": area_under_roc(found, truth),
        "calibration": {
            "expected calibration error": measured.error,
            "Brier": measured.brier,
            "log loss": measured.log_loss,
            "bins": [{"probability": told, "caught share": share, "examples": count} for told, share, count in measured.bins],
        },
        "against": against,
        "by horizon": {text: part(mine) for text, mine in bins.items() if mine.any()},
        "by hider": {kind.decode(): part(hider == kind) for kind in np.unique(hider)},
    }


def without_nan(value: Any) -> Any:
    """Return a tree of JSON values with None for what is not a number (a measure of one class that needs both)."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
