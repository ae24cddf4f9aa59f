"""What a hider can know at the start of a game: games played on in arenas that look the same to it.

At step 0 the hider sees the seeker and knows that it faces it, so all that is hidden from it is what stands where it does not
look, and chance. Every simulation gets an arena of its own: boxes that the hider sees stay as they are (it is told even their
hidden sides), boxes that it does not see are drawn anew from the distribution of the layout `random` until the exact view, and so
the camera's picture, is the very same. No predictor that is shown this view and this plan can be right more often in the long run
than the majority of such games, except by learning less of the unseen boxes than their distribution tells.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from learning.dataset import Dataset, Samples
from learning.roll_outs.game import Lens, Minds
from learning.roll_outs.outcomes import (
    catch_steps_of_continuations,
    catch_steps_of_goals,
    recorded_hider,
    simulation_seeds,
)
from learning.roll_outs.start import Start
from services.seeker.policy import PRESETS
from vantage.compiled import kernel
from vantage.cores import available_cores
from vantage.world.arena import ARENA_SIZE, GOALS, HIDER, ROBOT_RADIUS, SEEKER
from vantage.world.camera import Camera
from vantage.world.layout import MINIMUM_GAP, box_gap, propose_box
from vantage.world.motion import heading_radians, is_free
from vantage.world.rays import BOX_STRIDE, BOX_X, BOX_Y, cast_row

ATTEMPTS = 100_000
"""Draws of the unseen boxes before the true ones are taken: some views leave them next to no other place."""


@kernel
def draw_unseen(
    rightward: NDArray[np.float64],  # [W]
    mount_height: float,
    boxes: NDArray[np.float64],  # [n, 7]
    start: NDArray[np.float64],  # [2, 3] x, y (m), heading number; row 0 the hider
    seed: int,
    boxes_out: NDArray[np.float64],  # [n, 7]
) -> int:
    """Draw an arena that the hider cannot tell from the true one; return how many boxes were drawn anew, -1 where none was found
    (then the true ones are in `boxes_out`)."""
    columns = rightward.shape[0]
    true_depths, depths = np.empty(columns), np.empty(columns)
    surfaces = np.empty(columns, np.int64)
    x, y, angle = start[HIDER, 0], start[HIDER, 1], heading_radians(int(start[HIDER, 2]))
    other_x, other_y = start[SEEKER, 0], start[SEEKER, 1]
    cast_row(rightward, mount_height, boxes, ARENA_SIZE, ARENA_SIZE, x, y, angle, other_x, other_y, SEEKER, true_depths, surfaces)
    count = boxes.shape[0]
    seen = np.zeros(count, np.bool_)
    for u in range(columns):
        face = surfaces[u] % BOX_STRIDE
        if face in (BOX_X, BOX_Y):
            seen[surfaces[u] // BOX_STRIDE] = True
    unseen = count - seen.sum()
    boxes_out[:] = boxes
    if unseen == 0:
        return 0
    for attempt in range(ATTEMPTS):
        for index in range(count):
            if not seen[index]:
                propose_box(seed, attempt, index, ARENA_SIZE, ARENA_SIZE, boxes_out)
        fits = is_free(boxes_out, ARENA_SIZE, ARENA_SIZE, x, y, ROBOT_RADIUS)
        fits = fits and is_free(boxes_out, ARENA_SIZE, ARENA_SIZE, other_x, other_y, ROBOT_RADIUS)
        for index in range(count):
            for other in range(index):
                fits = fits and ((seen[index] and seen[other]) or box_gap(boxes_out, index, other) >= MINIMUM_GAP)
        if not fits:
            continue
        cast_row(
            rightward, mount_height, boxes_out, ARENA_SIZE, ARENA_SIZE, x, y, angle, other_x, other_y, SEEKER, depths, surfaces
        )
        same = True
        for u in range(columns):
            same = same and depths[u] == true_depths[u]
        if same:
            return unseen
    boxes_out[:] = boxes
    return -1


def imagined_catch_steps(
    dataset: Dataset, samples: Samples, simulations: int, workers: int = 0, progress: Callable[[int], None] | None = None
) -> tuple[NDArray[np.int32], float]:
    """Return the catch steps [B, simulations] of games in arenas that look the same to the hider, -1: survived; and the share of
    simulations for which no other arena was found.

    Args:
        samples: with t0 = 0.
        workers: threads; 0 = one for each core.
        progress: called with 1 after each sample.

    Raises:
        ValueError: a sample does not begin at step 0, an episode is not of the layout `random`, or cannot be played again.
    """
    lens = Lens.of(Camera())
    if np.any(samples.start != 0):
        raise ValueError("what a hider can know is simulated from step 0 only")

    def judge(index: int) -> tuple[NDArray[np.int32], int]:
        row = int(samples.episode[index])
        episode = dataset.episodes[row]
        if episode["layout"] != b"random":
            raise ValueError(f"the episode of seed {int(episode['seed'])} is not of the layout `random`")
        start, goal, primitives = recorded_hider(dataset, row)
        caught, arena, minds, failed = np.empty(simulations, np.int32), np.empty_like(start.boxes), Minds.empty(), 0
        for s, seed in enumerate(simulation_seeds(start.seed, simulations)):
            failed += draw_unseen(lens.rightward, lens.mount_height, start.boxes, start.poses, seed, arena) < 0
            catch_steps_of_continuations(
                *(lens, arena, start.poses, goal[0], goal[1], primitives, PRESETS[episode["seeker"].decode()]),
                *(start.catch_distance, int(samples.horizon[index]), start.seed, 0),
                *(np.array([seed]), minds, caught[s : s + 1]),
            )
        if progress:
            progress(1)
        return caught, failed

    with ThreadPoolExecutor(workers or available_cores()) as pool:
        found = list(pool.map(judge, range(len(samples))))
    return np.stack([caught for caught, _ in found]), sum(failed for _, failed in found) / (len(found) * simulations)


def imagined_goal_steps(
    start: Start, goals: NDArray[np.integer], seeds: NDArray[np.integer], seeker: str, steps: int
) -> NDArray[np.int32]:
    """Return the step [G, S] at which the hider is caught that drives to goal g in the s-th arena that looks the same to it; -1:
    it survives `steps`. Arguments as of `catch_steps`; the layout must be `random`.
    """
    lens, places, minds = Lens.of(Camera()), GOALS[np.asarray(goals, np.int64)], Minds.empty()
    caught, arena = np.empty((len(seeds), len(goals), 1), np.int32), np.empty_like(start.boxes)
    for s, seed in enumerate(np.asarray(seeds, np.int64)):
        draw_unseen(lens.rightward, lens.mount_height, start.boxes, start.poses, seed, arena)
        catch_steps_of_goals(
            *(lens, arena, start.poses, places, PRESETS[seeker], start.catch_distance, steps, start.seed),
            *(np.array([seed]), minds, caught[s]),
        )
    return caught[:, :, 0].T
