"""How a hider fares that drives to the goal a value map chose, from the simulations of every goal: nothing is simulated twice."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from learning.value_maps.truth import Case, counted, on_grid
from services.planner.value_map import choose_goal

OUTCOMES = ("V", "survival", "caught by 100", "caught by 200", "caught by T")
"""Of a goal, means over simulations: caught checkpoints, steps until the catch (T where there is none), shares caught."""

UNIFORM = "a goal at random"
BEST = "the best goal (chosen on half of the simulations, scored on the others)"


def outcomes_of(caught: NDArray[np.int32], horizon: int) -> NDArray[np.float64]:
    """Return OUTCOMES of each goal up to a horizon. [G, 5]

    Args:
        caught: catch steps [G, N], -1 = survived.
    """
    by = [(caught >= 0) & (caught <= steps) for steps in (min(100, horizon), min(200, horizon), horizon)]
    survival = np.where(by[-1], caught, horizon)
    return np.stack([each.mean(axis=1) for each in (counted(caught, horizon), survival, *by)], axis=1)


def play(case: Case, maps: Mapping[str, NDArray[np.float64]], horizon: int) -> dict[str, NDArray[np.float64]]:
    """Return OUTCOMES [5] of the goal that each map [121] chooses, of a uniform choice, and of the best goal.

    Scored on the simulations whose seeds are not the episode's own. The best goal is chosen on every second of them and scored
    on the others, and the other way round: chosen and scored on the same, luck would pass for skill.
    """
    simulated = case.caught[:, 1:]
    outcomes = outcomes_of(simulated, horizon)
    row = {goal: index for index, goal in enumerate(case.goals.tolist())}
    found = {name: outcomes[row[choose_goal(values, *case.hider)]] for name, values in maps.items()}
    found[UNIFORM] = outcomes.mean(axis=0)
    halves = simulated[:, 0::2], simulated[:, 1::2]
    best = []
    for chosen_on, scored_on in (halves, halves[::-1]):
        values = on_grid(case.goals, counted(chosen_on, horizon).mean(axis=1))
        best.append(outcomes_of(scored_on, horizon)[row[choose_goal(values, *case.hider)]])
    found[BEST] = np.mean(best, axis=0)
    return found
