"""Starts: free, in sight, at the wanted distance, facing each other, the same for the same seed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas import Box
from tests.world import reference
from vantage.world import arena
from vantage.world.layout import ImpossibleLayout, boxes_array, make_layout
from vantage.world.motion import heading_radians, is_free, line_of_sight
from vantage.world.start import draw_start

SIZE = arena.ARENA_SIZE


@given(
    seed=st.integers(0, 2**62), layout=st.sampled_from(["lab", "random"]), minimum=st.floats(0.15, 0.5), span=st.floats(0.0, 0.4)
)
@settings(max_examples=100, deadline=None)
def test_a_start_is_as_promised(seed: int, layout: str, minimum: float, span: float) -> None:
    boxes = boxes_array(make_layout(layout, seed))
    places = draw_start(boxes, SIZE, SIZE, seed, minimum, minimum + span)
    assert places == draw_start(boxes, SIZE, SIZE, seed, minimum, minimum + span)
    (hider_x, hider_y, _), (seeker_x, seeker_y, _) = places
    assert minimum - 1e-9 <= math.hypot(seeker_x - hider_x, seeker_y - hider_y) <= minimum + span + 1e-9
    assert line_of_sight(boxes, hider_x, hider_y, seeker_x, seeker_y)
    for (x, y, heading), (other_x, other_y, _) in (places, places[::-1]):
        assert is_free(boxes, SIZE, SIZE, x, y, arena.ROBOT_RADIUS)
        assert isinstance(heading, int)
        assert 0 <= heading < 36
        off = math.remainder(math.atan2(other_y - y, other_x - x) - heading_radians(heading), 2 * math.pi)
        assert abs(off) <= math.radians(5.0) + 1e-9


def test_starts_are_spread_over_the_arena_and_differ_by_seed() -> None:
    boxes = np.empty((0, 7))
    starts = np.array([draw_start(boxes, SIZE, SIZE, seed, 0.25, 0.45)[0] for seed in range(600)])
    assert len(np.unique(starts[:, 0])) == 600
    assert np.histogram2d(starts[:, 0], starts[:, 1], bins=3, range=[[0.065, 1.135]] * 2)[0].min() > 25
    assert np.bincount(starts[:, 2].astype(int), minlength=36).min() > 2


def test_the_start_shows_each_robot_to_the_other() -> None:
    for seed in range(30):
        boxes, hider, seeker = reference.scene(seed, 0.25, 0.45)
        offset = math.atan2(seeker[1] - hider[1], seeker[0] - hider[0]) - heading_radians(hider[2])
        assert abs(math.remainder(offset, 2 * math.pi)) < math.radians(43.0)
        assert line_of_sight(boxes, *hider[:2], *seeker[:2])


@pytest.mark.parametrize(
    ("obstacles", "minimum", "maximum"),
    [
        ((), 1.7, 1.8),
        ((), 0.0, 0.1),
        ((Box(x=0.6, y=0.6, half_width=0.52, half_depth=0.52),), 0.25, 0.45),
    ],
)
def test_where_no_start_fits_it_says_so(obstacles: tuple[Box, ...], minimum: float, maximum: float) -> None:
    with pytest.raises(ImpossibleLayout, match=f"{minimum:g} to {maximum:g} m apart"):
        draw_start(boxes_array(obstacles), SIZE, SIZE, 1, minimum, maximum)
