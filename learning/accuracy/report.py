"""What is said of methods that judged the same examples, as it stands in the JSON."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from learning.dataset import Dataset, Samples
from learning.measures import area_under_roc, balanced_accuracy, calibration, clustered_interval

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
    `interval 95 %`), `by horizon` and `by hider` (`examples`, `caught share`, `accuracy`, `interval 95 %`). Of a method that was
    trained with several seeds all are means over these (calibration: of the answers of all), the intervals are those of the mean
    when episodes are drawn again, and `over seeds` (see `spread`) says how far the trainings lie apart.

    Args:
        logits: of "caught", by method, [B], or [seeds, B]; a method may have judged fewer than all examples.
    """
    answers = {name: np.atleast_2d(found) for name, found in logits.items()}
    return {name: _one(name, found, answers, data, examples.part(0, found.shape[1]), seed) for name, found in answers.items()}


def spread(values: list[float]) -> dict[str, Any]:
    """Return how far trainings that differ by their seed lie apart: `n`, `values`, `sd` (n - 1), `range`."""
    return {
        "n": len(values),
        "values": values,
        "sd": float(np.std(values, ddof=1)),
        "range": [min(values), max(values)],
    }


def _one(
    name: str, found: NDArray[np.float32], logits: dict[str, NDArray[np.float32]], data: Dataset, examples: Samples, seed: int
) -> dict[str, Any]:
    truth, said, episode = examples.caught, found > 0, examples.episode
    right = _right(found, truth)
    against = {}
    for reference in REFERENCES:
        if reference != name and reference in logits and logits[reference].shape[1] >= len(truth):
            gain = right - _right(logits[reference][:, : len(truth)], truth)
            against[reference] = {
                "difference": float(gain.mean()),
                "interval 95 %": list(clustered_interval(gain, episode, seed)),
            }
    measured = calibration(found.ravel(), np.tile(truth, len(found)))

    def part(mine: NDArray[np.bool_]) -> dict[str, Any]:
        return {
            "examples": int(mine.sum()),
            "caught share": float(truth[mine].mean()),
            "accuracy": float(right[mine].mean()),
            "interval 95 %": list(clustered_interval(right[mine], episode[mine], seed)),
        }

    hider = data.episodes["hider"][episode]
    starts = range(0, int(examples.horizon.max()) + 1, BIN)
    bins = {f"{first}..{first + BIN - 1}": examples.horizon // BIN == first // BIN for first in starts}
    return {
        "examples": len(truth),
        "accuracy": float(right.mean()),
        "accuracy interval 95 %": list(clustered_interval(right, episode, seed)),
        **({"over seeds": spread([float(each.mean()) for each in said == truth])} if len(found) > 1 else {}),
        "balanced accuracy": float(np.mean([balanced_accuracy(each, truth) for each in said])),
        "AUROC": float(np.mean([area_under_roc(each, truth) for each in found])),
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


def _right(found: NDArray[np.float32], truth: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the share of the trainings whose answer is right, of each example. [B]"""
    return ((found > 0) == truth).mean(axis=0)


def without_nan(value: Any) -> Any:
    """Return a tree of JSON values with None for what is not a number (a measure of one class that needs both)."""
    if isinstance(value, dict):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
