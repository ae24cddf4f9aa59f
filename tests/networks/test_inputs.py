"""The inputs of VPT-TOB are the state image in colour and the action maps, turned together."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vantage.networks.inputs import CHANNELS, render_inputs, render_targets
from vantage.perception.action_maps import draw_action_maps, transform_image
from vantage.perception.palette import OTHER, OWN, to_rgb


def turned(image: np.ndarray, k: int) -> np.ndarray:
    out = np.empty_like(image)
    transform_image(image, k, out)
    return out


@settings(max_examples=24, deadline=None)
@given(seed=st.integers(0, 2**32), symmetry=st.integers(0, 7), horizon=st.integers(0, 59), start=st.integers(0, 40))
def test_inputs_are_the_coloured_view_and_the_action_maps_under_one_symmetry(
    seed: int, symmetry: int, horizon: int, start: int
) -> None:
    generator = np.random.default_rng(seed)
    views = generator.integers(0, 5, (3, 128, 128), dtype=np.uint8)
    positions = generator.uniform(-0.1, 1.3, (100, 3)).astype(np.float32)
    out = np.full((2, 128, 128, CHANNELS), 77, np.uint8)
    render_inputs(
        views,
        np.array([2, 1]),
        positions,
        np.array([start, 0]),
        np.array([horizon, 3]),
        np.array([symmetry, 0]),
        out,
    )
    frequency, time = np.empty((128, 128, 2), np.uint8), np.empty((128, 128, 2), np.uint8)
    draw_action_maps(positions[start:], 0, horizon, frequency, time)
    expected = [*np.moveaxis(to_rgb(views[2]), -1, 0), *np.moveaxis(frequency, -1, 0), *np.moveaxis(time, -1, 0)]
    for channel, image in enumerate(expected):
        np.testing.assert_array_equal(out[0, ..., channel], turned(np.ascontiguousarray(image), symmetry))
    np.testing.assert_array_equal(out[1, ..., :3], to_rgb(views[1]))


def test_an_input_beyond_the_end_of_the_positions_is_refused() -> None:
    zero = np.zeros(1, np.int64)
    with pytest.raises(ValueError, match="action maps"):
        render_inputs(
            np.zeros((1, 128, 128), np.uint8),
            zero,
            np.zeros((5, 2), np.float32),
            zero,
            zero + 5,
            zero,
            np.empty((1, 128, 128, CHANNELS), np.uint8),
        )


@pytest.mark.parametrize("symmetry", range(8))
def test_targets_are_the_coloured_view_and_where_the_robots_are(symmetry: int) -> None:
    views = np.random.default_rng(symmetry).integers(0, 5, (1, 128, 128), dtype=np.uint8)
    out, discs = np.empty((1, 128, 128, 3), np.uint8), np.empty((1, 128, 128), np.bool_)
    render_targets(views, np.array([symmetry]), out, discs)
    view = turned(views[0], symmetry)
    np.testing.assert_array_equal(out[0], to_rgb(view))
    np.testing.assert_array_equal(discs[0], np.isin(view, (OWN, OTHER)))
