"""When the hider is caught, over many simulations: of plans from a start, and of games of a data set gone on from any step."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from learning.dataset import Dataset, Samples
from learning.hiders.goal_walk import chosen_goal
from learning.hiders.table import policy_generator
from learning.roll_outs.game import NO_PRIMITIVES, Lens, Minds, roll_out_game
from learning.roll_outs.start import Start, first_view, start_of
from services.planner.controller import Controller
from services.seeker.policy import PRESETS
from vantage.compiled import kernel
from vantage.cores import available_cores
from vantage.world.arena import ARENA_SIZE, BACKWARD, FORWARD, GOALS, HIDER, LEFT, RIGHT, STAY, TURN
from vantage.world.camera import Camera

Item = TypeVar("Item")
Result = TypeVar("Result")

_SIMULATION_SEED = 1_000_003  # simulation s of an episode draws from seed * this + s + 1: never the episode's own


def simulation_seeds(seed: int, simulations: int) -> NDArray[np.int64]:
    """Return the seeds [S] of further simulations of the game with this seed."""
    return np.int64(seed) * _SIMULATION_SEED + 1 + np.arange(simulations, dtype=np.int64)


@kernel
def catch_steps_of_continuations(  # type: ignore[no-untyped-def]
    lens,
    boxes,
    start,
    goal_x,
    goal_y,
    primitives,
    attention,
    catch_distance,
    steps,
    known_seed,
    known_until,
    seeds,
    minds,
    caught_out,
):
    """Play one game on with every seed: catch steps to int32 [S]. See `roll_out_game`."""
    arena, known = (boxes, ARENA_SIZE, ARENA_SIZE), (known_seed, known_until)
    no_track = np.empty((0, 2, 3))
    for s in range(len(seeds)):
        caught_out[s] = roll_out_game(
            lens, *arena, start, goal_x, goal_y, primitives, attention, catch_distance, steps, *known, seeds[s], minds, no_track
        )


@kernel
def catch_steps_of_goals(lens, boxes, start, goals, attention, catch_distance, steps, known_seed, seeds, minds, caught_out):  # type: ignore[no-untyped-def]
    """Move the hider to every goal with every seed: catch steps to int32 [G, S]. See `roll_out_game`."""
    game = (attention, catch_distance, steps, known_seed, 0, seeds, minds)
    no_primitives = np.empty(0, np.int64)
    for g in range(len(goals)):
        catch_steps_of_continuations(lens, boxes, start, goals[g, 0], goals[g, 1], no_primitives, *game, caught_out[g])


def catch_steps(
    start: Start, goals: NDArray[np.integer], seeds: NDArray[np.integer], seeker: str, steps: int
) -> NDArray[np.int32]:
    """Return the step [G, S] at which the hider is caught when it drives to goal g in simulation s; -1: it survives `steps`.

    The hider drives with the planner's controller and finds new paths as it does in play. Everything up to step 0, its first
    view included, is drawn from the start's own seed; what comes later from `seeds` [S]: with the start's own seed it is the game
    itself. Releases the GIL.

    Args:
        goals: numbers of goals. [G]
        seeker: a preset of `services.seeker.policy`.
    """
    caught = np.empty((len(goals), len(seeds)), np.int32)
    places = GOALS[np.asarray(goals, np.int64)]
    catch_steps_of_goals(
        *(Lens.of(Camera()), start.boxes, start.poses, places, PRESETS[seeker], start.catch_distance, steps, start.seed),
        *(np.asarray(seeds, np.int64), Minds.empty(), caught),
    )
    return caught


def oracle_catch_steps(
    dataset: Dataset, samples: Samples, simulations: int, workers: int = 0, progress: Callable[[int], None] | None = None
) -> NDArray[np.int32]:
    """Return for each sample the catch steps [B, simulations] of games that go on from its true state at t0; -1: survived.

    Each plays the episode again from its start (it is deterministic) with the true hider, layout and seeker, memories included,
    and draws camera noise and exploration anew after t0. Steps count from the episode's start.

    Args:
        workers: threads; 0 = one for each core.
        progress: called with 1 after each sample.

    Raises:
        ValueError: an episode was not played by a hider that can be played again, or not under the default rules.
    """
    lens = Lens.of(Camera())

    def judge(index: int) -> NDArray[np.int32]:
        row = int(samples.episode[index])
        episode = dataset.episodes[row]
        start, goal, primitives = recorded_hider(dataset, row)
        caught = np.empty(simulations, np.int32)
        catch_steps_of_continuations(
            *(lens, start.boxes, start.poses, goal[0], goal[1], primitives, PRESETS[episode["seeker"].decode()]),
            *(start.catch_distance, int(samples.start[index] + samples.horizon[index]), start.seed, int(samples.start[index])),
            *(simulation_seeds(start.seed, simulations), Minds.empty(), caught),
        )
        if progress:
            progress(1)
        return caught

    with ThreadPoolExecutor(workers or available_cores()) as pool:
        return np.stack(list(pool.map(judge, range(len(samples)))))


def recorded_hider(dataset: Dataset, row: int) -> tuple[Start, tuple[float, float], NDArray[np.int64]]:
    """Return start, goal (m; NaN where it had none) and primitives [L] of the hider of an episode: all that it takes to play the
    episode again.

    Raises:
        ValueError: see `oracle_catch_steps`.
    """
    episode = dataset.episodes[row]
    seed, hider = int(episode["seed"]), dataset.name_of(row, "hider")
    start = start_of(dataset.name_of(row, "layout"), seed)
    recorded = dataset.steps["hider"][episode["first_step"]]
    x, y, heading = start.poses[HIDER].tolist()
    if abs(recorded["x"] - x) > 1e-5 or abs(recorded["y"] - y) > 1e-5:
        raise ValueError(f"the episode of seed {seed} does not begin as the simulator begins it under the default rules")
    nowhere = (float("nan"), float("nan"))
    if hider == "goal-walk":
        controller = Controller()
        controller.observe(first_view(start), x, y, int(heading), 0)
        goal = chosen_goal(controller, policy_generator(seed), x, y, int(heading))
        return start, nowhere if goal is None else goal, NO_PRIMITIVES
    if hider in ("random", "replay"):
        return start, nowhere, _open_loop_primitives(dataset, row)
    raise ValueError(f"the hider `{hider}` of the episode of seed {seed} reacts to what it sees: it cannot be played again")


def _open_loop_primitives(dataset: Dataset, row: int) -> NDArray[np.int64]:
    """Read the primitives [T] off the plans: each plan drives them from its first step in an empty arena."""
    episode = dataset.episodes[row]
    first, count = int(episode["first_step"]), int(episode["steps"])
    primitives = np.full(int(episode["horizon"]), STAY, np.int64)
    in_force = dataset.steps["plan"][first : first + count]
    for number in np.unique(in_force[in_force >= 0]).tolist():
        plan = dataset.plans[number]
        path = dataset.positions[plan["first_position"] : plan["first_position"] + plan["positions"]].astype(np.float64)
        turned = np.rint(np.diff(path[:, 2]) / TURN).astype(np.int64) % 36
        along = np.diff(path[:, 0]) * np.cos(path[:-1, 2]) + np.diff(path[:, 1]) * np.sin(path[:-1, 2])
        steps = np.select([turned == 1, turned == 35, along > 0.005, along < -0.005], [LEFT, RIGHT, FORWARD, BACKWARD], STAY)
        primitives[plan["start"] : plan["start"] + len(steps)] = steps[: len(primitives) - int(plan["start"])]
    return primitives
