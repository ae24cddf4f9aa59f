"""The action vector tells where the path is every ten steps and where it ends, turned with the picture."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vantage.networks.action_vector import SLOTS, VECTOR_LENGTH, render_vectors
from vantage.perception.action_maps import transform_path
from vantage.world.arena import ARENA_SIZE


def vector(positions: np.ndarray, first: int, horizon: int, symmetry: int) -> np.ndarray:
    out = np.full((1, VECTOR_LENGTH), 77, np.float32)
    render_vectors(positions, np.array([first]), np.array([horizon]), np.array([symmetry]), out)
    return out[0]


def reference(path: np.ndarray, horizon: int) -> np.ndarray:
    """The same by its description: `path` begins at step 0."""
    out = np.zeros((SLOTS, 3))
    steps = [*range(10, horizon, 10), horizon]
    out[: len(steps), :2] = np.clip((path[steps, :2] - ARENA_SIZE / 2) / (ARENA_SIZE / 2), -1, 1)
    out[: len(steps), 2] = 1
    return np.concatenate([out.ravel(), [horizon / 400]])


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32), first=st.integers(0, 20), horizon=st.integers(0, 400), symmetry=st.integers(0, 7))
def test_a_turned_vector_is_the_vector_of_the_turned_path(seed: int, first: int, horizon: int, symmetry: int) -> None:
    positions = np.random.default_rng(seed).uniform(-0.1, ARENA_SIZE + 0.1, (first + horizon + 1, 3)).astype(np.float32)
    found = vector(positions, first, horizon, symmetry)
    np.testing.assert_allclose(found, vector(transform_path(positions, symmetry), first, horizon, 0), atol=1e-6)
    np.testing.assert_allclose(found, reference(transform_path(positions[first:], symmetry), horizon), atol=1e-6)
    end = reference(transform_path(positions[first + horizon :], symmetry), 0)[:2]
    slots = found[:-1].reshape(SLOTS, 3)
    np.testing.assert_allclose(slots[int(slots[:, 2].sum()) - 1, :2], end, atol=1e-6)


@pytest.mark.parametrize(("first", "horizon"), [(0, 500), (0, -1), (-1, 5), (4, 5)])
def test_what_no_vector_can_tell_is_refused(first: int, horizon: int) -> None:
    with pytest.raises(ValueError, match="action vector"):
        vector(np.zeros((501 if horizon == 500 else 9, 3), np.float32), first, horizon, 0)
