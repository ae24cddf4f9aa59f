"""Colour calibration: the correction makes colours canonical under any usable light; patches that teach nothing are refused."""

from __future__ import annotations

import contextlib
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vantage.perception.scan import COLOR_DISTANCE, is_robot_color
from vantage.rehearsal.rgbd_picture import RgbdCamera, RgbdLook, render_rgbd
from vantage.tracking.colors import (
    PatchColor,
    UnusableColors,
    color_quality,
    correct_colors,
    grow_region,
    lighting_limits,
    measure_click,
    measure_rectangle,
)
from vantage.world.arena import BOX_COLOR, FLOOR_COLOR, HIDER_COLOR, SEEKER_COLOR, WALL_COLOR

Color = tuple[float, float, float]


def card(color: Color, gains: tuple[float, ...] = (1.0, 1.0, 1.0), sigma: float = 3.0, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, sigma, (40, 40, 3))
    return np.clip(np.array(color) * np.array(gains) + noise + 0.5, 0, 255).astype(np.uint8)


def patch(color: Color, gains: tuple[float, ...] = (1.0, 1.0, 1.0), sigma: float = 3.0, seed: int = 0) -> PatchColor:
    return measure_rectangle(card(color, gains, sigma, seed), 0, 0, 40, 40)


def three(gains: tuple[float, ...] = (1.0, 1.0, 1.0), seed: int = 0) -> tuple[PatchColor, PatchColor, PatchColor]:
    return (
        patch(HIDER_COLOR, gains, seed=seed),
        patch(SEEKER_COLOR, gains, seed=seed + 1),
        patch(FLOOR_COLOR, gains, seed=seed + 2),
    )


HALF_HIDER = measure_rectangle(np.hstack([card(HIDER_COLOR), card(WALL_COLOR)]), 10, 0, 45, 40)
REDDENING = (card(HIDER_COLOR) + np.arange(0, 160, 4)[:, None, None] * np.array([1, 0, 0])).astype(np.uint8)
SHADED_HIDER = measure_rectangle(REDDENING, 0, 0, 40, 40)


gain = st.floats(0.6, 1.5)


@given(red=gain, green=gain, blue=gain, brightness=st.floats(0.4, 1.6), seed=st.integers(0, 1000))
@settings(max_examples=150, deadline=None)
def test_measured_colors_become_canonical_under_any_light(
    red: float, green: float, blue: float, brightness: float, seed: int
) -> None:
    gains = (red * brightness, green * brightness, blue * brightness)
    patches = three(gains, seed)
    # Refused only where pixels are cut at 255, or where noise of 3 is much of what little light there is.
    brightest = np.max(np.array([HIDER_COLOR, SEEKER_COLOR, FLOOR_COLOR]) * gains)
    if brightest > 245.0 or min(sum(each.mean) for each in patches) < 80.0:
        with contextlib.suppress(UnusableColors):
            correct_colors(*patches)
        return
    correction, quality = correct_colors(*patches)
    hider, seeker, grey = correction.apply([each.mean for each in patches])
    assert hider == pytest.approx(HIDER_COLOR, abs=4.0)
    assert seeker == pytest.approx(SEEKER_COLOR, abs=4.0)
    assert np.ptp(grey) < 4.0
    # Every shade of grey of this light is taken for nobody, the robots for themselves, half as bright too.
    for color, robots in ((WALL_COLOR, []), (FLOOR_COLOR, []), (BOX_COLOR, []), (HIDER_COLOR, [0]), (SEEKER_COLOR, [1])):
        for shade in (0.5, 1.0):
            seen = np.rint(correction.apply(np.minimum(np.array(color) * gains * shade, 255.0))).astype(int).tolist()
            assert [robot for robot in (0, 1) if is_robot_color(*seen, robot)] == robots
    assert 0.02 <= quality.margin <= COLOR_DISTANCE


def test_canonical_colors_are_left_alone() -> None:
    correction, quality = correct_colors(*three())
    assert np.array(correction.matrix).reshape(3, 3) == pytest.approx(np.eye(3), abs=0.1)
    assert quality.margin > 0.1


@pytest.mark.parametrize(
    ("low", "high", "channels"),
    [(0.4, 1.6, (0, 1, 2)), (0.6, 1.5, (0,)), (0.6, 1.5, (1,)), (0.6, 1.5, (2,))],
    ids=["brightness", "red", "green", "blue"],
)
def test_the_stated_limits_of_light_hold_without_calibrating_again(low: float, high: float, channels: tuple[int, ...]) -> None:
    patches = three()
    correction, _ = correct_colors(*patches)
    limits = lighting_limits(correction, *patches)
    measured = (limits.brightness, limits.red, limits.green, limits.blue)[0 if len(channels) == 3 else 1 + channels[0]]
    assert measured[0] <= low and measured[1] >= high
    for factor in np.linspace(low, high, 25):
        gains = [factor if channel in channels else 1.0 for channel in range(3)]
        for color, robots in ((HIDER_COLOR, [0]), (SEEKER_COLOR, [1]), (WALL_COLOR, []), (FLOOR_COLOR, [])):
            seen = np.rint(correction.apply(np.minimum(np.array(color) * gains, 255.0))).astype(int).tolist()
            assert [robot for robot in (0, 1) if is_robot_color(*seen, robot)] == robots


def test_limits_are_where_the_filter_turns() -> None:
    patches = three()
    correction, _ = correct_colors(*patches)
    limits = lighting_limits(correction, *patches)
    for factor, right in ((limits.red[1], True), (limits.red[1] * 1.03, False), (limits.red[0] / 1.03, False)):
        found = []
        for each in patches:
            seen = np.rint(correction.apply(np.minimum(np.array(each.mean) * (factor, 1.0, 1.0), 255.0))).astype(int).tolist()
            found.append([robot for robot in (0, 1) if is_robot_color(*seen, robot)])
        assert (found == [[0], [1], []]) == right


def test_other_paints_are_made_canonical() -> None:
    patches = patch((40, 120, 70)), patch((170, 70, 60)), patch((150, 140, 120))
    correction, quality = correct_colors(*patches)
    assert correction.apply(patches[0].mean) == pytest.approx(HIDER_COLOR, abs=4.0)
    assert correction.apply(patches[1].mean) == pytest.approx(SEEKER_COLOR, abs=4.0)
    assert quality.margin > 0.04
    before = color_quality(type(correction)(), *patches)
    assert before.margin < quality.margin


@pytest.mark.parametrize(
    ("patches", "text"),
    [
        ((patch(HIDER_COLOR, (0.15,) * 3, 0.5), patch(SEEKER_COLOR), patch(FLOOR_COLOR)), "hider is too dark"),
        ((patch(HIDER_COLOR), patch((300, 40, 40)), patch(FLOOR_COLOR)), "seeker is saturated"),
        ((patch(HIDER_COLOR), patch(SEEKER_COLOR), patch((260, 260, 260))), "grey is saturated"),
        ((patch(HIDER_COLOR), patch(HIDER_COLOR), patch(FLOOR_COLOR)), "hider and seeker are too alike"),
        ((patch((110, 125, 112)), patch(SEEKER_COLOR), patch(FLOOR_COLOR)), "hider and grey are too alike"),
        ((SHADED_HIDER, patch(SEEKER_COLOR), patch(FLOOR_COLOR)), "hider is too uneven"),
        ((HALF_HIDER, patch(SEEKER_COLOR), patch(FLOOR_COLOR)), "hider is too uneven"),
        ((patch((95, 145, 100), sigma=20.0), patch((150, 95, 100), sigma=20.0), patch(FLOOR_COLOR)), "told safely"),
    ],
)
def test_patches_that_teach_nothing_are_refused(patches: tuple[PatchColor, PatchColor, PatchColor], text: str) -> None:
    with pytest.raises(UnusableColors, match=text) as caught:
        correct_colors(*patches)
    assert "\n" not in str(caught.value)


def test_a_click_measures_the_surface_under_it() -> None:
    camera = RgbdCamera(look=RgbdLook(unevenness=0.3))
    _, picture = render_rgbd(camera, np.zeros((0, 7)), (0.3, 0.6, 0.0), (0.6, 0.6), 1, 1, 0, 0)
    redness = picture.astype(int) @ (2, -1, -1)
    rows, columns = np.nonzero(redness > 150)
    x, y = int(np.median(columns)), int(np.median(rows))
    region = grow_region(picture, x, y)
    robot = redness > 150
    assert np.count_nonzero(region & robot) > 0.8 * np.count_nonzero(robot)
    assert np.count_nonzero(region & ~robot) == 0
    measured = measure_click(picture, x, y)
    middle = np.median(picture[robot], axis=0)
    assert measured.mean == pytest.approx(middle, abs=3.0)
    assert measured.pixels == np.count_nonzero(region)
    floor = measure_click(picture, 320, 460)
    assert np.ptp(floor.mean) < 12


def test_clicks_and_patches_outside_or_in_the_dark_are_refused() -> None:
    picture = card(HIDER_COLOR)
    for x, y in ((-1, 0), (40, 0), (0, 40)):
        with pytest.raises(UnusableColors, match="outside the picture"):
            measure_click(picture, x, y)
    for rectangle in ((-1, 0, 5, 5), (38, 0, 5, 5), (0, 0, 0, 5), (0, 0, 5, 41)):
        with pytest.raises(UnusableColors, match="leaves the picture"):
            measure_rectangle(picture, *rectangle)
    with pytest.raises(UnusableColors, match="too dark"):
        measure_click(np.zeros((40, 40, 3), np.uint8), 20, 20)
    with pytest.raises(UnusableColors, match="needs 30"):
        measure_rectangle(picture, 0, 0, 5, 5)
    for wrong in (picture[..., :2], picture.astype(np.float32), picture[:0], picture[..., 0]):
        with pytest.raises(UnusableColors, match="uint8"):
            measure_rectangle(wrong, 0, 0, 5, 5)


def test_a_patch_of_one_colour_has_no_spread_and_no_nan() -> None:
    flat = measure_rectangle(np.full((40, 40, 3), 90, np.uint8), 0, 0, 40, 40)
    assert flat.mean == (90.0, 90.0, 90.0) and not any(flat.covariance) and flat.strange == 0.0
    assert all(map(math.isfinite, flat.covariance))
