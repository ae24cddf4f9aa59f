"""What of a request must be computed: each distinct (path prefix, horizon) once. Paths to many goals share their beginnings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class DistinctQueries:
    """The distinct queries of a request, D of them.

    Attributes:
        path: int64 [D], a path that begins with the query's prefix.
        horizon: int64 [D], steps.
        query: int64 [paths, horizons], which distinct query answers each pair.
    """

    path: NDArray[np.int64]
    horizon: NDArray[np.int64]
    query: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.path)


def distinct_queries(paths: NDArray[np.float32], horizons: NDArray[np.int64]) -> DistinctQueries:
    """Find the distinct queries. Two are the same when their horizons are and all positions up to it are, bit by bit.

    Args:
        paths: [P, S, 2] positions of steps 0 .. S - 1.
        horizons: [H] steps, each below S, in any order, repeated or not.
    """
    count = len(paths)
    ascending, place = np.unique(horizons, return_inverse=True)
    group = np.zeros(count, np.int64)  # paths of one group are the same up to the horizon before
    found_paths, found_horizons = [], []
    query = np.empty((count, len(ascending)), np.int64)
    reached, found = 0, 0
    for column, horizon in enumerate(ascending.tolist()):
        piece = np.ascontiguousarray(paths[:, reached : horizon + 1]).view(np.uint8).reshape(count, -1)
        rows = np.concatenate([group.view(np.uint8).reshape(count, 8), piece], axis=1)
        _, first, group = np.unique(rows.view(f"V{rows.shape[1]}").ravel(), return_index=True, return_inverse=True)
        found_paths.append(first)
        found_horizons.append(np.full(len(first), horizon, np.int64))
        query[:, column] = found + group
        found += len(first)
        reached = horizon + 1
    return DistinctQueries(np.concatenate(found_paths), np.concatenate(found_horizons), query[:, place])
