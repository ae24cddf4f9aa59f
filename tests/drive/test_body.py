"""The emulated body: moves as a differential drive does, lags, slips, collides, and is the same for the same seed."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas import Box
from vantage.rehearsal.body import Body, BodySettings, clearance
from vantage.world.layout import boxes_array

IDEAL = BodySettings(lag=0.0, slip=0.0, left_scale=1.0, right_scale=1.0)
NOTHING = boxes_array(())
BOXES = boxes_array((Box(x=0.6, y=0.6, half_width=0.1, half_depth=0.05, heading=0.3),))


def drive(body: Body, seconds: float, left: float, right: float, boxes: np.ndarray = NOTHING, dt: float = 0.004) -> None:
    generator = np.random.default_rng(3)
    for _ in range(round(seconds / dt)):
        body.step(dt, left, right, boxes, None, generator)


def test_equal_speeds_drive_straight_and_opposite_ones_turn_on_the_spot() -> None:
    body = Body(IDEAL, 0.5, 0.5, 0.7)
    drive(body, 1.0, 0.1, 0.1)
    assert (body.x, body.y) == pytest.approx((0.5 + 0.1 * math.cos(0.7), 0.5 + 0.1 * math.sin(0.7)), abs=1e-9)
    assert body.left == pytest.approx(0.1) and body.right == pytest.approx(0.1)
    drive(body, 0.5, -0.05, 0.05)
    assert body.heading == pytest.approx(0.7 + 0.05 / IDEAL.axle_track)


@given(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))
def test_without_slip_it_drives_the_exact_arc(left: float, right: float) -> None:
    """Closed form of a differential drive: radius and angle of the arc."""
    body = Body(IDEAL, 0.6, 0.6, 0.0)
    drive(body, 0.4, left, right)
    turn, ahead = (right - left) * 0.4 / IDEAL.axle_track, 0.2 * (left + right)
    radius = math.inf if abs(turn) < 1e-9 else ahead / turn
    x, y = (ahead, 0.0) if math.isinf(radius) else (radius * math.sin(turn), radius * (1.0 - math.cos(turn)))
    assert (body.x - 0.6, body.y - 0.6, body.heading) == pytest.approx((x, y, turn), abs=2e-5)


def test_wheels_lag() -> None:
    body = Body(BodySettings(lag=0.05, slip=0.0), 0.5, 0.5, 0.0)
    drive(body, 0.048, 0.2, 0.2)
    assert body.left_speed == pytest.approx(0.2 * (1.0 - math.exp(-0.048 / 0.05)), rel=1e-6)


def test_slip_shows_on_the_floor_but_not_in_the_encoders() -> None:
    ends = []
    for seed in range(300):
        body, generator = Body(BodySettings(slip=0.03, left_scale=1.0, right_scale=1.0, lag=0.0), 0.2, 0.6, 0.0), None
        generator = np.random.default_rng(seed)
        for _ in range(25):
            body.step(0.004, 0.1, 0.1, NOTHING, None, generator)
        assert body.left == pytest.approx(0.01)
        ends.append(body.x - 0.2)
    # Of 10 mm each wheel misses 0.3 mm, their mean 0.3 / sqrt(2).
    assert np.std(ends) == pytest.approx(0.0003 / math.sqrt(2), rel=0.15)


@given(st.integers(0, 1000), st.lists(st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)), min_size=1, max_size=12))
def test_it_never_drives_into_anything(seed: int, speeds: list[tuple[float, float]]) -> None:
    body, generator = Body(BodySettings(), 0.45, 0.45, 1.0), np.random.default_rng(seed)
    other = (0.25, 0.40)
    for left, right in speeds:
        for _ in range(20):
            body.step(0.016, left, right, BOXES, other, generator)
            assert clearance(BOXES, 1.2, 1.2, body.x, body.y, body.settings.radius, *other) >= 0.0


def test_against_a_wall_the_wheels_turn_on_and_it_can_leave() -> None:
    body = Body(IDEAL, 0.075, 0.6, math.pi)
    drive(body, 1.0, 0.1, 0.1)
    assert body.touching
    assert body.x == pytest.approx(IDEAL.radius, abs=0.001)
    assert body.left == pytest.approx(0.1)
    drive(body, 0.5, -0.1, -0.1)
    assert not body.touching and body.x > 0.11


def test_the_same_seed_gives_the_same_way() -> None:
    def way() -> tuple[float, float, float]:
        body, generator = Body(BodySettings(), 0.5, 0.5, 0.0), np.random.default_rng(9)
        for index in range(100):
            body.step(0.01, 0.1, 0.02 * (index % 7), BOXES, None, generator)
        return body.x, body.y, body.heading

    assert way() == way()
