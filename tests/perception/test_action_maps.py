"""F and T against a slow reference, their prefixes, their scale, and the symmetries of the square."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from vantage.perception.action_maps import (
    draw_action_maps,
    draw_batch,
    draw_horizons,
    extend_action_maps,
    transform_image,
    transform_path,
)


def wandering(seed: int, steps: int = 120) -> NDArray[np.float64]:
    """Positions of a robot that drives, turns and waits, and may come to the arena's edge. [steps, 2]"""
    generator = np.random.default_rng(seed)
    heading = np.cumsum(generator.normal(0.0, 0.3, steps))
    going = np.repeat(generator.random(steps // 10 + 1) < 0.7, 10)[:steps]
    path = 0.010 * going[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.clip(generator.uniform(0.05, 1.15, 2) + np.cumsum(path, axis=0), 0.001, 1.199)


def reference(path: NDArray[np.floating], start: int, stop: int) -> NDArray[np.uint8]:
    """The same maps, pixel by pixel from their definition: F luminance, F alpha, T luminance, T alpha. [4, 128, 128]"""
    maps = np.zeros((4, 128, 128), np.uint8)
    column = np.clip(np.floor(path[:, 0] / (1.2 / 128)), 0, 127).astype(int)
    row = np.clip(np.floor((1.2 - path[:, 1]) / (1.2 / 128)), 0, 127).astype(int)
    for r in range(128):
        for c in range(128):
            if np.min(np.abs(row - r) + np.abs(column - c)) > 4:
                continue
            away = (row - r) ** 2 + (column - c) ** 2
            visits = [step for step in range(start, stop + 1) if away[step] <= 6]
            if visits:
                maps[0, r, c] = round(255 * (1 - math.log(1 + min(400, len(visits))) / math.log(401)))
                maps[2, r, c] = round(255 * (1 - min(400, visits[-1] - start) / 400))
                maps[1, r, c] = maps[3, r, c] = 255
    return maps


def planes(path: NDArray[np.floating], start: int, stop: int) -> NDArray[np.uint8]:
    frequency, time = np.full((128, 128, 2), 7, np.uint8), np.full((128, 128, 2), 7, np.uint8)
    draw_action_maps(path, start, stop, frequency, time)
    return np.stack([frequency[..., 0], frequency[..., 1], time[..., 0], time[..., 1]])


@pytest.mark.parametrize("seed", range(4))
def test_maps_are_those_of_the_definition(seed: int) -> None:
    path = wandering(seed)
    for start, stop in ((0, 119), (17, 60), (50, 50)):
        np.testing.assert_array_equal(planes(path, start, stop), reference(path, start, stop))


@given(st.integers(0, 10_000), st.lists(st.integers(20, 119), min_size=1, max_size=8))
@settings(deadline=None, max_examples=30)
def test_prefixes_are_the_maps_of_their_horizon(seed: int, horizons: list[int]) -> None:
    path = wandering(seed)
    stops = np.sort(np.array(horizons))
    out = np.full((len(stops), 4, 128, 128), 9, np.uint8)
    draw_horizons(path, 20, stops, out)
    batch = np.full_like(out, 9)
    draw_batch(np.repeat(path[None].astype(np.float32), len(stops), axis=0), np.full(len(stops), 20), stops, batch)
    for k, stop in enumerate(stops):
        np.testing.assert_array_equal(out[k], planes(path, 20, stop))
        np.testing.assert_array_equal(batch[k], planes(path.astype(np.float32), 20, stop))


def test_extending_step_by_step_is_drawing_at_once() -> None:
    path = wandering(11)
    maps, counts = np.zeros((4, 128, 128), np.uint8), np.zeros((128, 128), np.uint16)
    for first, stop in ((3, 3), (4, 40), (41, 41), (42, 119)):
        extend_action_maps(path, 3, first, stop, counts, maps[0], maps[1], maps[2], maps[3])
    np.testing.assert_array_equal(maps, planes(path, 3, 119))


def test_visits_and_waits_are_told_apart_on_an_absolute_scale() -> None:
    darkness = []
    for waits in (0, 1, 4, 20, 100, 200, 300, 399):
        maps = planes(np.full((400, 2), 0.5), 0, waits)
        assert np.sum(maps[1] == 255) == np.sum(maps[3] == 255) == 21
        darkness.append(int(maps[0].max()))
        assert maps[2].max() == round(255 * (1 - waits / 400))
    assert darkness[0] == 226
    assert darkness[-1] == 0
    assert all(a - b >= 6 for a, b in pairwise(darkness)), darkness
    np.testing.assert_array_equal(planes(np.full((900, 2), 0.5), 0, 899), planes(np.full((900, 2), 0.5), 0, 500))


def test_the_latest_visit_wins() -> None:
    there_and_back = np.concatenate([np.linspace(0.3, 0.9, 61), np.linspace(0.9, 0.3, 61)])
    maps = planes(np.stack([there_and_back, np.full(122, 0.6)], axis=1), 0, 121)
    assert maps[2][64, 32] < maps[2][64, 92] < 220
    assert maps[2][64, 32] == round(255 * (1 - 121 / 400))


def test_positions_that_are_not_numbers_are_left_out() -> None:
    path = wandering(2)
    holed = path.copy()
    holed[40:60] = np.nan
    holed[60] = np.inf
    frequency_alpha = planes(holed, 0, 119)[1]
    assert 0 < np.sum(frequency_alpha) <= np.sum(planes(path, 0, 119)[1])
    assert planes(np.full((5, 2), -50.0), 0, 4)[1][126:, :2].all()


def test_impossible_stretches_are_refused() -> None:
    frequency, time = np.zeros((128, 128, 2), np.uint8), np.zeros((128, 128, 2), np.uint8)
    for start, stop in ((-1, 5), (0, 120)):
        with pytest.raises(ValueError, match="action maps need"):
            draw_action_maps(wandering(1), start, stop, frequency, time)
    with pytest.raises(ValueError, match="ascending"):
        draw_horizons(wandering(1), 0, np.array([50, 20]), np.zeros((2, 4, 128, 128), np.uint8))


@given(st.integers(0, 10_000), st.integers(0, 7))
@settings(deadline=None, max_examples=60)
def test_symmetries_commute_with_drawing(seed: int, k: int) -> None:
    path = wandering(seed)
    turned = np.empty((4, 128, 128), np.uint8)
    for plane, out in zip(planes(path, 0, 119), turned, strict=True):
        transform_image(plane, k, out)
    np.testing.assert_array_equal(planes(transform_path(path, k), 0, 119), turned)


def test_the_eight_symmetries_are_those_of_numpy_and_all_different() -> None:
    image = np.random.default_rng(0).integers(0, 5, (128, 128)).astype(np.uint8)
    out = np.empty((8, 128, 128), np.uint8)
    for k in range(8):
        transform_image(image, k, out[k])
        np.testing.assert_array_equal(out[k], np.rot90(np.fliplr(image) if k >= 4 else image, k % 4))
    assert len({view.tobytes() for view in out}) == 8
    with pytest.raises(ValueError, match="eight"):
        transform_image(image, 8, out[0])
    with pytest.raises(ValueError, match="eight"):
        transform_path(np.zeros((3, 2)), -1)


def test_headings_turn_with_their_path() -> None:
    ahead = np.array([[0.5, 0.4, 0.3], [0.5 + 0.01 * math.cos(0.3), 0.4 + 0.01 * math.sin(0.3), 0.3]], dtype=np.float32)
    for k in range(8):
        turned = transform_path(ahead, k)
        assert turned.dtype == np.float32
        step = turned[1, :2] - turned[0, :2]
        bearing = math.atan2(step[1], step[0])
        assert math.cos(bearing - turned[0, 2]) == pytest.approx(1.0, abs=1e-5)
    np.testing.assert_array_equal(ahead[0, :2], np.float32([0.5, 0.4]))
