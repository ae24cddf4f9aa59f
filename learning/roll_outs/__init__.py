"""Compiled whole games: the ground truth of value maps, and the Monte Carlo oracle."""

from learning.roll_outs.outcomes import catch_steps, oracle_catch_steps, simulation_seeds
from learning.roll_outs.start import Start, first_view, goal_paths, start_of
from learning.roll_outs.unseen import imagined_catch_steps, imagined_goal_steps

__all__ = [
    "Start",
    "catch_steps",
    "first_view",
    "goal_paths",
    "imagined_catch_steps",
    "imagined_goal_steps",
    "oracle_catch_steps",
    "simulation_seeds",
    "start_of",
]
