"""Compiled whole games: the ground truth of value maps, and the Monte Carlo oracle."""

from learning.roll_outs.outcomes import catch_steps, oracle_catch_steps, simulation_seeds
from learning.roll_outs.start import Start, first_view, goal_paths, start_of

__all__ = ["Start", "catch_steps", "first_view", "goal_paths", "oracle_catch_steps", "simulation_seeds", "start_of"]
