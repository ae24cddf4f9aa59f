"""Statistics of a LeRobot data set: of each episode, and of all together, as its normalisation wants them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)

Statistics = dict[str, NDArray[Any]]
"""min, max, mean, std and q01 .. q99 of a feature, each of one shape, and `count` [1]."""


def name_of(quantile: float) -> str:
    """Return what LeRobot calls a quantile: `q01` for 0.01."""
    return f"q{round(100 * quantile):02d}"


def of_rows(rows: NDArray[Any]) -> Statistics:
    """Return the statistics of numbers [n, ...], n at least 1, along the first axis; scalars [n] come out with shape [1]."""
    values = np.asarray(rows, np.float64)
    values = values[:, None] if values.ndim == 1 else values
    found = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
    found["count"] = np.array([len(values)])
    for quantile in QUANTILES:
        found[name_of(quantile)] = np.quantile(values, quantile, axis=0)
    return found


class Histogram:
    """Exact statistics of pictures by how often each level occurs, a channel at a time."""

    def __init__(self, channels: int, levels: int, scale: float, shape: tuple[int, ...]) -> None:
        """Args:
        levels: values are 0 .. levels - 1.
        scale: what a level is divided by.
        shape: of each statistic; holds `channels` numbers.
        """
        self._counts = np.zeros((channels, levels), np.int64)
        self._scale = scale
        self._shape = shape
        self._pictures = 0

    def add(self, picture: NDArray[Any]) -> None:
        """Take a picture [H, W] or [H, W, channels]."""
        channels, levels = self._counts.shape
        flat = picture.reshape(-1, channels)
        for channel in range(channels):
            self._counts[channel] += np.bincount(flat[:, channel], minlength=levels)
        self._pictures += 1

    def statistics(self) -> Statistics:
        """Return the statistics of what was added, at least one picture."""
        levels = np.arange(self._counts.shape[1], dtype=np.float64)
        total = self._counts.sum(1)  # [channels]
        mean = self._counts @ levels / total
        variance = np.maximum(self._counts @ levels**2 / total - mean**2, 0.0)
        up_to = self._counts.cumsum(1)
        found: Statistics = {
            "min": (self._counts > 0).argmax(1).astype(np.float64),
            "max": len(levels) - 1 - (self._counts[:, ::-1] > 0).argmax(1).astype(np.float64),
            "mean": mean,
            "std": np.sqrt(variance),
        }
        for quantile in QUANTILES:
            found[name_of(quantile)] = (up_to >= quantile * total[:, None]).argmax(1).astype(np.float64)
        found = {name: (value / self._scale).reshape(self._shape) for name, value in found.items()}
        found["count"] = np.array([self._pictures])
        return found


class Total:
    """Statistics of all episodes, from theirs (the quantiles as their weighted mean, as LeRobot itself does it)."""

    def __init__(self) -> None:
        self._features: dict[str, Statistics] = {}

    def add(self, episode: dict[str, Statistics]) -> None:
        """Take an episode's statistics, by feature."""
        for feature, new in episode.items():
            known = self._features.get(feature)
            self._features[feature] = new if known is None else _joined(known, new)

    def as_lists(self) -> dict[str, dict[str, Any]]:
        """Return feature -> statistic -> nested lists."""
        return {feature: as_lists(statistics) for feature, statistics in self._features.items()}


def as_lists(statistics: Statistics) -> dict[str, Any]:
    """Return the statistics as nested lists."""
    return {name: value.tolist() for name, value in statistics.items()}


def _joined(one: Statistics, other: Statistics) -> Statistics:
    counts = one["count"], other["count"]
    total = counts[0] + counts[1]
    share = counts[1][0] / total[0]
    difference = other["mean"] - one["mean"]
    variance = (1 - share) * one["std"] ** 2 + share * other["std"] ** 2 + share * (1 - share) * difference**2
    joined = {name: one[name] + share * (other[name] - one[name]) for name in one if name.startswith("q")}
    joined |= {"min": np.minimum(one["min"], other["min"]), "max": np.maximum(one["max"], other["max"])}
    joined |= {"mean": one["mean"] + share * difference, "std": np.sqrt(variance), "count": total}
    return joined
