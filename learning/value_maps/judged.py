"""A method's value map: questions for every goal and checkpoint, and V from its answers."""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from learning.methods.method import Method, Questions
from learning.value_maps.truth import INTERVAL, Case, on_grid
from services.planner.value_map import Value, checkpoints, values_of

VALUES: tuple[Value, ...] = ("binary", "expected")
"""The ways to add up a method's answers: v in {0, 1} as in the paper, or probabilities."""


def questions_of(case: Case, horizon: int) -> Questions:
    """Return what is asked about one map: goal after goal, each at every checkpoint up to the horizon, of its whole plan."""
    steps = np.array(checkpoints(horizon, INTERVAL), np.int64)
    count, length = case.paths.shape[:2]
    first = np.repeat(np.arange(count, dtype=np.int64) * length, len(steps))
    return Questions(
        views=case.view[None],
        view_of=np.zeros(len(first), np.int64),
        positions=case.paths.reshape(-1, 3),
        first=first,
        last=first + length - 1,
        horizons=np.tile(steps, count),
    )


def caught_probability(method: Method, case: Case, horizon: int) -> NDArray[np.float32]:
    """Return a method's probability that the hider is caught by each checkpoint on its way to each goal. [G, K]"""
    logits = method.judge(questions_of(case, horizon)).reshape(len(case.goals), -1).astype(np.float64)
    return (0.5 * (1 + np.tanh(0.5 * logits))).astype(np.float32)  # the sigmoid, without overflow


def maps_of(method: Method, case: Case, horizons: Sequence[int]) -> dict[Value, NDArray[np.float64]]:
    """Return a method's value maps [H, 121], NaN where no goal is proposed, added up in both ways."""
    caught = caught_probability(method, case, max(horizons))  # a shorter map has the first checkpoints of the longest
    parts = [caught[:, : len(checkpoints(horizon, INTERVAL))] for horizon in horizons]
    return {value: np.stack([on_grid(case.goals, values_of(part, value)) for part in parts]) for value in VALUES}


def seconds_per_map(method: Method, cases: Sequence[Case], horizon: int) -> float:
    """Return the median time in which a method answers all questions about one map, s; one warm-up is left out."""
    durations = []
    for case in (cases[0], *cases):
        began = time.perf_counter()
        caught_probability(method, case, horizon)
        durations.append(time.perf_counter() - began)
    return statistics.median(durations[1:])
