"""The game step: order does not matter, nobody overlaps, the catch is where it is said to be, cameras as alone."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.world import reference
from vantage.world import arena
from vantage.world.camera import Camera, directions, render
from vantage.world.game import is_caught, move_both, step_game
from vantage.world.motion import heading_radians, is_free

SIZE = arena.ARENA_SIZE
NO_BOXES = np.empty((0, 7))
seeds = st.integers(0, 2**40)
pairs = st.tuples(st.integers(0, 4), st.integers(0, 4))


def moved(
    boxes: reference.Floats, poses: npt.ArrayLike, primitives: tuple[int, int]
) -> tuple[reference.Floats, npt.NDArray[np.bool_]]:
    after, done = np.empty((2, 3)), np.empty(2, np.bool_)
    move_both(boxes, SIZE, SIZE, np.array(poses, np.float64), np.array(primitives), after, done)
    return after, done


@given(seed=seeds, moves=st.lists(pairs, max_size=80), toward=st.booleans())
@settings(max_examples=60, deadline=None)
def test_robots_never_overlap_and_their_order_does_not_matter(seed: int, moves: list[tuple[int, int]], toward: bool) -> None:
    boxes, hider, seeker = reference.scene(seed, 0.131, 0.16 if toward else 0.4)
    poses = np.array([hider, seeker], np.float64)
    for primitives in [(arena.FORWARD, arena.FORWARD)] * 3 * toward + moves:
        after, done = moved(boxes, poses, primitives)
        swapped, swapped_done = moved(boxes, poses[::-1], primitives[::-1])
        np.testing.assert_array_equal(after, swapped[::-1])
        np.testing.assert_array_equal(done, swapped_done[::-1])
        np.testing.assert_array_equal(after[~done], poses[~done])
        assert math.hypot(*(after[0, :2] - after[1, :2])) >= 2 * arena.ROBOT_RADIUS - 1e-9
        assert all(is_free(boxes, SIZE, SIZE, x, y, arena.ROBOT_RADIUS) for x, y, _ in after.tolist())
        poses = after


@pytest.mark.parametrize(
    ("gap", "expected"),
    [(0.151, (True, True)), (0.149, (False, False)), (0.139, (False, False))],
)
def test_robots_that_would_meet_both_stay(gap: float, expected: tuple[bool, bool]) -> None:
    poses = [(0.5, 0.6, 0), (0.5 + gap, 0.6, 18)]
    _, done = moved(NO_BOXES, poses, (arena.FORWARD, arena.FORWARD))
    assert tuple(done) == expected
    _, done = moved(NO_BOXES, poses, (arena.FORWARD, arena.LEFT))
    assert tuple(done) == (gap > 0.14, True)


def test_moving_in_place_is_the_same() -> None:
    boxes, hider, seeker = reference.scene(4)
    poses = np.array([hider, seeker], np.float64)
    expected, _ = moved(boxes, poses, (arena.LEFT, arena.FORWARD))
    move_both(boxes, SIZE, SIZE, poses, np.array([arena.LEFT, arena.FORWARD]), poses, np.empty(2, np.bool_))
    np.testing.assert_array_equal(poses, expected)


@given(angle=st.floats(0, 2 * math.pi), x=st.floats(0.3, 0.9), y=st.floats(0.3, 0.9))
def test_exactly_the_catch_distance_is_caught(angle: float, x: float, y: float) -> None:
    for distance, caught in ((0.15, True), (0.1499, True), (0.15001, False), (0.0, True)):
        assert is_caught(x, y, x + distance * math.cos(angle), y + distance * math.sin(angle), 0.15) == caught


@given(seed=seeds, primitives=pairs, step=st.integers(0, 400), noise=st.booleans())
@settings(max_examples=30, deadline=None)
def test_a_whole_step_is_its_parts(seed: int, primitives: tuple[int, int], step: int, noise: bool) -> None:
    boxes, hider, seeker = reference.scene(seed, 0.15, 0.3)
    poses = np.array([hider, seeker], np.float64)
    camera = Camera(noise=noise)
    depths, colors = np.empty((2, 1, 128), np.uint16), np.empty((2, 1, 128, 3), np.uint8)
    after, done = np.empty((2, 3)), np.empty(2, np.bool_)
    caught = step_game(
        *directions(camera),
        camera.mount_height,
        noise,
        boxes,
        SIZE,
        SIZE,
        poses,
        np.array(primitives),
        arena.CATCH_DISTANCE,
        seed,
        step,
        after,
        done,
        depths,
        colors,
    )
    expected, expected_done = moved(boxes, poses, primitives)
    np.testing.assert_array_equal(after, expected)
    np.testing.assert_array_equal(done, expected_done)
    assert caught == (math.hypot(*(after[0, :2] - after[1, :2])) <= arena.CATCH_DISTANCE + 1e-9)
    for robot in range(2):
        depth, color = np.empty((1, 128), np.uint16), np.empty((1, 128, 3), np.uint8)
        x, y, heading = after[robot].tolist()
        other_x, other_y, _ = after[1 - robot].tolist()
        place = (x, y, heading_radians(int(heading)), other_x, other_y)
        render(camera, boxes, SIZE, SIZE, *place, 1 - robot, seed, step, robot, depth, color)
        np.testing.assert_array_equal(depths[robot], depth)
        np.testing.assert_array_equal(colors[robot], color)
