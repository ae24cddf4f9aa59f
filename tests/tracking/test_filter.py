from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vantage.tracking.filter import FilterSettings, PoseFilter, TrackState

FRAME = 33_333_333
SIGMA = np.diag(np.square([2e-4, 2e-4, 2e-3]))


def state_of(filter_: PoseFilter) -> TrackState:
    state = filter_.state
    assert state is not None
    return state


def driven(seconds: float, speed: tuple[float, float, float], noise: float = 0.0) -> tuple[PoseFilter, np.ndarray, int]:
    """A filter that followed a robot of constant speed, the robot's pose, and the stamp."""
    filter_, random = PoseFilter(), np.random.default_rng(1)
    pose, stamp = np.array([0.3, 0.4, 3.0]), 10**9
    for _ in range(round(seconds * 30)):
        pose, stamp = pose + np.array(speed) * FRAME * 1e-9, stamp + FRAME
        filter_.predict(stamp)
        measured = pose + noise * random.standard_normal(3) * np.sqrt(np.diag(SIGMA))
        measured[2] = math.remainder(measured[2], math.tau)
        assert filter_.correct(measured, SIGMA, stamp)
    return filter_, pose, stamp


@pytest.mark.parametrize("rate", [2.0, -2.0])
def test_follows_place_heading_and_rates_across_the_wrap(rate: float) -> None:
    filter_, pose, _ = driven(2.0, (0.1, -0.05, rate))
    state = state_of(filter_)
    assert (state.x, state.y) == pytest.approx(pose[:2], abs=1e-4)
    assert math.remainder(state.heading - pose[2], math.tau) == pytest.approx(0.0, abs=1e-3)
    assert abs(state.heading) <= math.pi
    assert (state.speed_x, state.speed_y, state.turn_rate) == pytest.approx((0.1, -0.05, rate), abs=0.01)
    assert state.seen


def test_errors_are_as_large_as_the_covariance_says() -> None:
    squares = []
    for seed in range(60):
        random = np.random.default_rng(seed)
        filter_, pose, stamp = PoseFilter(), np.zeros(3), 0
        speed = np.zeros(3)
        for _ in range(40):
            stamp += FRAME
            acceleration = random.standard_normal(3) * [2.0, 2.0, 30.0]
            passed = FRAME * 1e-9
            pose, speed = pose + speed * passed + acceleration * passed**2 / 2, speed + acceleration * passed
            filter_.predict(stamp)
            filter_.correct(pose + random.standard_normal(3) * np.sqrt(np.diag(SIGMA)), SIGMA, stamp)
        state = state_of(filter_)
        xx, xy, xh, yy, yh, hh = state.covariance
        error = np.array([state.x - pose[0], state.y - pose[1], math.remainder(state.heading - pose[2], math.tau)])
        squares.append(error @ np.linalg.inv([[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]]) @ error)
    # Chi-squared of 3 degrees of freedom has mean 3; that of 60 of them strays by 0.32 (standard deviation).
    assert 2.0 < np.mean(squares) < 4.3


def test_predicts_says_so_and_forgets() -> None:
    filter_, pose, stamp = driven(1.0, (0.2, 0.0, 0.0))
    certain = state_of(filter_).covariance[0]
    filter_.predict(stamp + 4 * FRAME)
    state = state_of(filter_)
    assert not state.seen
    assert state.x == pytest.approx(pose[0] + 0.2 * 4 * FRAME * 1e-9, abs=1e-3)
    assert state.covariance[0] > 4 * certain
    filter_.predict(stamp + 16 * FRAME)
    assert filter_.state is None


def test_one_wild_pose_is_not_believed_three_are() -> None:
    filter_, pose, stamp = driven(1.0, (0.0, 0.0, 0.0))
    elsewhere = pose + np.array([0.3, 0.2, 1.0])
    for count in range(3):
        stamp += FRAME
        filter_.predict(stamp)
        believed = filter_.correct(elsewhere, SIGMA, stamp)
        assert believed == (count == 2)
    state = state_of(filter_)
    assert (state.x, state.y) == pytest.approx(elsewhere[:2])
    assert state.seen and state.speed_x == 0.0


def test_a_clock_that_goes_backwards_ends_the_track() -> None:
    filter_, _, stamp = driven(1.0, (0.0, 0.0, 0.0))
    filter_.predict(stamp - FRAME)
    assert filter_.state is None


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 4), st.booleans(), st.floats(-0.02, 0.02)), min_size=1, max_size=60),
    st.floats(0.0, 10.0),
)
def test_covariance_stays_positive_and_heading_within_pi(steps: list[tuple[int, bool, float]], heading: float) -> None:
    filter_ = PoseFilter(FilterSettings(forget_after=100.0))
    stamp = 0
    filter_.correct(np.array([0.5, 0.5, math.remainder(heading, math.tau)]), SIGMA, stamp)
    for frames, sees, off in steps:
        stamp += frames * FRAME
        filter_.predict(stamp)
        if sees:
            filter_.correct(np.array([0.5 + off, 0.5 - off, math.remainder(heading + 10 * off, math.tau)]), SIGMA, stamp)
        state = state_of(filter_)
        xx, xy, xh, yy, yh, hh = state.covariance
        assert np.linalg.eigvalsh([[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]]).min() > 0
        assert abs(state.heading) <= math.pi
