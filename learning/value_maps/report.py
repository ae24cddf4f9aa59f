"""All predictors' maps beside the ground truth: what goes into the results, as numbers and as arrays for figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from learning.value_maps.heuristics import HEURISTICS, seen_or_centre
from learning.value_maps.judged import VALUES
from learning.value_maps.play import BEST, OUTCOMES, UNIFORM, play
from learning.value_maps.ranking import agreement
from learning.value_maps.summary import over_seeds, summary
from learning.value_maps.truth import Case, counted, on_grid
from services.planner.value_map import choose_goal

COMPARED = ("with_ties", "without_ties", "ties_half", "tau_b")
ONE_SIMULATION = "one simulation"
ANOTHER = "another simulation"
VIEW_ORACLE_MAP = "view oracle"
"""The mean over arenas that look the same to the hider: the ceiling of what its view tells."""
ROUNDED = "rounded"

Maps = dict[str, NDArray[np.float64]]
"""Predictor -> value maps [S, H, 121] of S starts at H horizons; [K, S, H, 121] of a method that was trained with K seeds."""


def mean_of(simulations: int) -> str:
    """Return what the mean over so many simulations is called."""
    return f"mean of {simulations} simulations"


def heuristic_maps(cases: Sequence[Case], horizons: Sequence[int]) -> Maps:
    """Return the value maps that need no learning; they know no horizon."""
    return {
        name: np.stack(
            [
                np.tile(on_grid(case.goals, rule(case.hider, seen_or_centre(case.seeker))[case.goals]), (len(horizons), 1))
                for case in cases
            ]
        )
        for name, rule in HEURISTICS.items()
    }


def simulated_maps(cases: Sequence[Case], horizons: Sequence[int], columns: slice) -> NDArray[np.float64]:
    """Return the mean V over some columns of the cases' simulations. [S, H, 121]"""
    return np.stack(
        [
            np.stack([on_grid(case.goals, counted(case.caught[:, columns], horizon).mean(axis=1)) for horizon in horizons])
            for case in cases
        ]
    )


def ground_truths(cases: Sequence[Case], horizons: Sequence[int]) -> Maps:
    """Return the true maps: of one simulation with the episode's own seed (the paper's), and the mean of all others."""
    others = cases[0].caught.shape[1] - 1
    return {
        ONE_SIMULATION: simulated_maps(cases, horizons, slice(0, 1)),
        mean_of(others): simulated_maps(cases, horizons, slice(1, None)),
    }


def references(cases: Sequence[Case], horizons: Sequence[int], truth: str) -> Maps:
    """Return what simulation says that has nothing in common with a ground truth but the start, or the hider's view of it: the
    ceilings."""
    truths = ground_truths(cases, horizons)
    if truth == ONE_SIMULATION:
        found = {ANOTHER: simulated_maps(cases, horizons, slice(1, 2)), **{k: v for k, v in truths.items() if k != truth}}
    else:
        found = {ANOTHER: truths[ONE_SIMULATION]}
    return found | imagined_maps(cases, horizons)


def imagined_maps(cases: Sequence[Case], horizons: Sequence[int]) -> Maps:
    """Return the mean V [S, H, 121] over the arenas that look the same to the hider, under the name `VIEW_ORACLE_MAP`; nothing
    where they were not simulated."""
    if not cases[0].imagined.shape[1]:
        return {}
    return {
        VIEW_ORACLE_MAP: np.stack(
            [
                np.stack([on_grid(case.goals, counted(case.imagined, horizon).mean(axis=1)) for horizon in horizons])
                for case in cases
            ]
        )
    }


def reference_of(name: str, against: str) -> str:
    """Return the predictor whose order of goals another's is compared with: the method `against`, added up in the same way."""
    value = name.rpartition(", ")[2]
    return f"{against}, {value if value in (*VALUES, ROUNDED) else 'expected'}"


def with_rounded(maps: Maps) -> Maps:
    """Return the maps, and beside those of added probabilities the same rounded to whole checkpoints: as the true V is whole,
    two goals often tie in it, and probabilities never do.
    """
    rounded = {name: f"{name.removesuffix(', expected')}, {ROUNDED}" for name in maps if name.endswith(", expected")}
    found = {}
    for name, values in maps.items():
        found[name] = values
        if name in rounded:
            found[rounded[name]] = np.round(values)
    return found


def ranking(
    cases: Sequence[Case], horizons: Sequence[int], maps: Maps, against: str, seed: int, free_only: bool = False
) -> dict[str, Any]:
    """Return horizon -> ground truth -> predictor -> measure -> summary over starts.

    Each measure also has the difference to the predictor `against` and the change since the first horizon, both paired by
    start.

    Args:
        maps: of the predictors.
        against: method that the others are compared with.
        free_only: leave out goals on which the hider cannot truly stand, which it proposes as it has not seen why.
    """
    mask = np.stack(
        [np.where(on_grid(case.goals, case.free.astype(np.int64)) == 1 if free_only else True, 0.0, np.nan) for case in cases]
    )
    found: dict[str, Any] = {str(horizon): {} for horizon in horizons}
    for truth, true_maps in ground_truths(cases, horizons).items():
        measured: dict[str, dict[str, NDArray[np.float64]]] = {}  # predictor -> measure -> [K, H, S]
        for name, predicted in {**with_rounded(maps), **references(cases, horizons, truth)}.items():
            table = [
                [
                    [asdict(agreement(each[s, h], true_maps[s, h] + mask[s])) for s in range(len(cases))]
                    for h in range(len(horizons))
                ]
                for each in by_seed(predicted)
            ]
            keys = table[0][0][0]
            measured[name] = {key: np.array([[[c[key] for c in row] for row in rows] for rows in table], float) for key in keys}
        for h, horizon in enumerate(horizons):
            found[str(horizon)][truth] = {
                name: {
                    key: _measure(values, measured.get(reference_of(name, against), {}).get(key), h, key, seed)
                    for key, values in measures.items()
                }
                for name, measures in measured.items()
            }
    return found


def by_seed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the maps of a predictor by training seed. [K, S, H, 121]"""
    return values if values.ndim == 4 else values[None]


def _measure(
    values: NDArray[np.float64],  # [K, H, S]
    reference: NDArray[np.float64] | None,  # [K, H, S]
    h: int,
    key: str,
    seed: int,
) -> dict[str, Any]:
    mean = values.mean(axis=0)  # over seeds; whether there is anything to measure depends on the truth alone
    found: dict[str, Any] = {**summary(mean[h], seed), **over_seeds(values[:, h])}
    if key in COMPARED:
        if reference is not None:
            found["difference"] = summary(mean[h] - reference.mean(axis=0)[h], seed)
        if h:
            found["change since the first horizon"] = summary(mean[h] - mean[0], seed)
    return found


def played(cases: Sequence[Case], horizons: Sequence[int], maps: Maps, against: str, seed: int) -> dict[str, Any]:
    """Return horizon -> who chose the goal -> outcome -> summary over starts, with the difference to the goal that `against`
    chooses by its probabilities, paired by start.
    """
    choosers = {**maps, ANOTHER: simulated_maps(cases, horizons, slice(0, 1)), **imagined_maps(cases, horizons)}
    found: dict[str, Any] = {}
    for h, horizon in enumerate(horizons):
        fared = dict[str, NDArray[np.float64]]()  # [K, S, 5]
        for k in range(max(len(by_seed(each)) for each in choosers.values())):
            some = {name: by_seed(each)[k] for name, each in choosers.items() if k < len(by_seed(each))}
            games = [play(case, {name: each[s, h] for name, each in some.items()}, horizon) for s, case in enumerate(cases)]
            for name in (*some, UNIFORM, BEST) if k == 0 else some:
                outcomes = np.stack([game[name] for game in games])[None]
                fared[name] = np.concatenate([fared[name], outcomes]) if name in fared else outcomes
        reference = fared.get(f"{against}, expected")
        found[str(horizon)] = {
            name: {
                outcome: {
                    **summary(outcomes[..., column].mean(axis=0), seed),
                    **over_seeds(outcomes[..., column]),
                    **_difference(outcomes, reference, column, seed),
                }
                for column, outcome in enumerate(OUTCOMES)
            }
            for name, outcomes in fared.items()
        }
    return found


def _difference(values: NDArray[np.float64], reference: NDArray[np.float64] | None, column: int, seed: int) -> dict[str, Any]:
    """Return the difference between two choosers' outcomes [K, S, 5], paired by start."""
    if reference is None:
        return {}
    return {"difference": summary(values[..., column].mean(axis=0) - reference[..., column].mean(axis=0), seed)}


def arrays(cases: Sequence[Case], horizons: Sequence[int], maps: Maps) -> Mapping[str, NDArray[Any]]:
    """Return what figures need, S starts, H horizons, P predictors, 1 + N simulations:

    seeds [S], views uint8 [S, 128, 128], poses [S, 2, 3] (x, y, heading number), boxes [S, n, 7] (NaN = no box), proposed and
    free bool [S, 121], horizons [H], truth and truth_mean [S, H, 121] (V of one simulation, mean of the others), caught int32
    [S, 121, 1 + N] (-1 survived, -2 no goal), predictors [P] (names), values [P, S, H, 121], chosen [P, S, H] (goals). Of a
    method trained with several seeds: the maps of the first.
    """
    maps = {name: by_seed(each)[0] for name, each in maps.items()}
    boxes = np.full((len(cases), max(len(case.boxes) for case in cases), 7), np.nan)
    caught = np.full((len(cases), 121, cases[0].caught.shape[1]), -2, np.int32)
    proposed, free = np.zeros((2, len(cases), 121), np.bool_)
    for s, case in enumerate(cases):
        boxes[s, : len(case.boxes)] = case.boxes
        caught[s, case.goals] = case.caught
        proposed[s, case.goals] = True
        free[s, case.goals] = case.free
    chosen = [[[choose_goal(one, *case.hider) for one in each[s]] for s, case in enumerate(cases)] for each in maps.values()]
    truth, truth_mean = ground_truths(cases, horizons).values()
    return {
        "seeds": np.array([case.seed for case in cases], np.int64),
        "views": np.stack([case.view for case in cases]),
        "poses": np.stack([case.poses for case in cases]),
        "boxes": boxes,
        "proposed": proposed,
        "free": free,
        "horizons": np.array(horizons, np.int64),
        "truth": truth.astype(np.float32),
        "truth_mean": truth_mean.astype(np.float32),
        "caught": caught,
        "predictors": np.array(list(maps)),
        "values": np.stack(list(maps.values())).astype(np.float32),
        "chosen": np.array(chosen, np.int64),
    }
