"""Starts nobody has trained on, and what becomes of a hider that drives from them to every goal."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from learning.roll_outs.outcomes import catch_steps, simulation_seeds
from learning.roll_outs.start import first_view, goal_paths, start_of
from learning.roll_outs.unseen import imagined_goal_steps
from learning.splits import SPLITS, split_of
from schemas import Rules
from services.planner.value_map import checkpoints
from vantage.cores import available_cores
from vantage.world.arena import ARENA_SIZE, GOALS, ROBOT_RADIUS
from vantage.world.motion import is_free

INTERVAL = 10
"""N: steps between the checkpoints that V counts (reading of the paper, row 14)."""

PLAN_STEPS = 200
"""Planned paths have at least so many steps, whatever the horizon: as long as those that networks have learnt from."""

_SEEDS = 2**31


@dataclass(frozen=True)
class Case:
    """One start, and how every goal turns out from there.

    Attributes:
        seed: of the episode.
        boxes: float64 [n, 7], as in `vantage.world.layout`.
        poses: float64 [2, 3], hider and seeker: x, y (m), heading number.
        view: uint8 [128, 128], the hider's first state image, palette indices.
        seeker: where that view shows the seeker, m; None = not at all.
        goals: int64 [G], the goals the planner proposes: reachable and not blocked, as far as the hider has seen.
        free: bool [G], whether the hider can truly stand there (boxes it has not seen yet may be in the way).
        paths: float32 [G, L + 1, 3], L = T or PLAN_STEPS if that is more: planned x, y (m), heading (rad).
        caught: int32 [G, 1 + N], the step of the catch, -1 = survived T steps. Column 0: the simulation with the episode's own
            seed (the paper's ground truth); then N with other seeds.
        imagined: int32 [G, M], the same in M arenas that look the same to the hider (layout `random`; else M = 0).
    """

    seed: int
    boxes: NDArray[np.float64]
    poses: NDArray[np.float64]
    view: NDArray[np.uint8]
    seeker: tuple[float, float] | None
    goals: NDArray[np.int64]
    free: NDArray[np.bool_]
    paths: NDArray[np.float32]
    caught: NDArray[np.int32]
    imagined: NDArray[np.int32]

    @property
    def hider(self) -> tuple[float, float]:
        """Where the hider starts, m."""
        return float(self.poses[0, 0]), float(self.poses[0, 1])


def seeds_of_test_split(seed: int, count: int) -> list[int]:
    """Return `count` different episode seeds of the test split: no network has trained or been chosen on them."""
    generator = np.random.default_rng([seed, 0x7E57])
    found: dict[int, None] = {}
    while len(found) < count:
        candidate = int(generator.integers(_SEEDS))
        if split_of(candidate) == SPLITS.index("test"):
            found[candidate] = None
    return list(found)


def play_out(episode_seed: int, rules: Rules, seeker: str, simulations: int) -> Case:
    """Return the case of an episode's seed: the hider moved to every goal, `1 + simulations` times, for rules.maximum_steps."""
    start = start_of(rules.layout, episode_seed, rules)
    seen = first_view(start)
    goals, paths = goal_paths(start, max(rules.maximum_steps, PLAN_STEPS))
    seeds = np.concatenate([[episode_seed], simulation_seeds(episode_seed, simulations)])
    others = simulation_seeds(episode_seed, simulations if rules.layout == "random" else 0)
    free = [is_free(start.boxes, ARENA_SIZE, ARENA_SIZE, x, y, ROBOT_RADIUS) for x, y in GOALS[goals].tolist()]
    return Case(
        episode_seed,
        start.boxes,
        start.poses,
        seen.image,
        seen.other,
        goals,
        np.array(free, np.bool_),
        paths.astype(np.float32),
        catch_steps(start, goals, seeds, seeker, rules.maximum_steps),
        imagined_goal_steps(start, goals, others, seeker, rules.maximum_steps),
    )


def cases_of(seeds: list[int], rules: Rules, seeker: str, simulations: int, workers: int = 0) -> Iterator[Case]:
    """Yield the cases of episode seeds, in order, several at a time (the kernels release the GIL); 0 workers = one a core."""
    with ThreadPoolExecutor(workers or available_cores(), "cases") as pool:
        yield from pool.map(lambda one: play_out(one, rules, seeker, simulations), seeds)


def counted(caught: NDArray[np.int32], horizon: int) -> NDArray[np.int64]:
    """Return V of each simulated game: how many of the checkpoints up to a horizon find the hider caught: its danger.

    Args:
        caught: catch steps of any shape, -1 = survived.
    """
    steps = np.array(checkpoints(horizon, INTERVAL))
    return ((caught[..., None] >= 0) & (caught[..., None] <= steps)).sum(axis=-1)


def on_grid(goals: NDArray[np.int64], values: NDArray[np.floating] | NDArray[np.integer]) -> NDArray[np.float64]:
    """Return a map [121] of the values of some goals, NaN elsewhere."""
    grid = np.full(len(GOALS), np.nan)
    grid[goals] = values
    return grid
