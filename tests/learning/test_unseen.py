"""What a hider can know: arenas that look the same to it."""

from __future__ import annotations

import numpy as np
import pytest

from learning.roll_outs import catch_steps, first_view, imagined_goal_steps, simulation_seeds, start_of
from learning.roll_outs.game import Lens
from learning.roll_outs.start import Start
from learning.roll_outs.unseen import draw_unseen
from vantage.world.arena import ARENA_SIZE, ROBOT_RADIUS
from vantage.world.camera import Camera
from vantage.world.layout import MINIMUM_GAP, box_gap
from vantage.world.motion import is_free


def drawn(start: Start, seed: int) -> tuple[int, np.ndarray]:
    lens = Lens.of(Camera())
    boxes = np.empty_like(start.boxes)
    return draw_unseen(lens.rightward, lens.mount_height, start.boxes, start.poses, seed, boxes), boxes


@pytest.mark.parametrize("seed", range(12))
def test_the_hider_cannot_tell_the_arenas_apart(seed: int) -> None:
    start = start_of("random", seed)
    view = first_view(start)
    for number in simulation_seeds(seed, 3):
        count, boxes = drawn(start, number)
        assert count >= 0
        moved = np.any(boxes != start.boxes, axis=1)
        assert moved.sum() == count
        other = Start(boxes, start.poses, start.seed, start.catch_distance)
        again = first_view(other)
        assert np.array_equal(again.image, view.image)
        assert np.array_equal(again.ranges, view.ranges, equal_nan=True)
        for x, y, _ in start.poses.tolist():
            assert is_free(boxes, ARENA_SIZE, ARENA_SIZE, x, y, ROBOT_RADIUS)
        for index in np.flatnonzero(moved):
            assert all(box_gap(boxes, index, k) >= MINIMUM_GAP for k in range(len(boxes)) if k != index)


def test_unseen_boxes_stand_elsewhere_in_every_simulation_and_a_seed_draws_the_same_again() -> None:
    start = next(start for seed in range(50) if drawn(start := start_of("random", seed), 1)[0] >= 2)
    first, second = drawn(start, 1)[1], drawn(start, 2)[1]
    assert np.any(first != second)
    assert np.array_equal(drawn(start, 1)[1], first)


def test_where_every_box_is_seen_imagination_is_simulation() -> None:
    """With nothing hidden, what the hider can know is the true state."""
    starts = (start_of("random", seed) for seed in range(3000))
    start = next(start for start in starts if drawn(start, 1)[0] == 0)
    goals, seeds = np.array([0, 60, 120]), simulation_seeds(start.seed, 4)
    assert np.array_equal(
        imagined_goal_steps(start, goals, seeds, "glancing", 60), catch_steps(start, goals, seeds, "glancing", 60)
    )


def test_what_is_hidden_makes_a_difference() -> None:
    """Somewhere an unseen box decides whether the hider is caught, or the ceiling of the view would be the oracle's."""
    differing = 0
    for seed in range(8):
        start = start_of("random", seed)
        goals, seeds = np.arange(0, 121, 20), simulation_seeds(seed, 6)
        imagined = imagined_goal_steps(start, goals, seeds, "glancing", 120)
        differing += int(np.sum(imagined != catch_steps(start, goals, seeds, "glancing", 120)))
    assert differing > 0
