"""The state image from rendered RGB-D against the ideal one: the benchmark, small; other mounts and lights."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from benchmarks.rgbd_state_image import compare, corrected, draw_scene, exact_view, false_findings, overlap, visible_share
from vantage.rehearsal.rgbd_picture import RgbdCamera, RgbdLook
from vantage.tracking.rgbd import RgbdPreparer, default_rgbd

CAMERA = RgbdCamera()
PREPARER = RgbdPreparer(CAMERA.geometry)


def test_the_visible_area_is_the_ideal_one_and_the_other_robot_is_found() -> None:
    figures = compare(range(5000, 5040), CAMERA, PREPARER)
    assert np.mean(figures.overlaps) >= 0.95
    assert np.percentile(figures.overlaps, 5) >= 0.90
    assert figures.half_visible >= 10
    assert figures.missed == []
    assert np.median(figures.place_errors or []) < 5.0


def test_nobody_is_found_where_nobody_is() -> None:
    assert false_findings(range(6000, 6040), CAMERA, PREPARER) == 0


@pytest.mark.parametrize(
    ("changes", "light"),
    [
        ({"tilt": math.radians(10.0)}, {}),
        ({"translation": (0.025, 0.0, 0.0)}, {}),
        ({}, {"red_gain": 1.05, "green_gain": 0.9, "blue_gain": 0.6, "brightness": 0.6}),
        ({}, {"red_gain": 0.7, "green_gain": 0.9, "blue_gain": 1.1, "brightness": 1.1}),
    ],
    ids=["tilted", "lenses apart the other way", "warm and dim", "cold and bright"],
)
def test_other_mounts_and_lights(changes: dict[str, object], light: dict[str, float]) -> None:
    camera = RgbdCamera(msgspec.structs.replace(default_rgbd(), **changes), RgbdLook(**light))
    preparer = RgbdPreparer(corrected(camera) if light else camera.geometry)
    figures = compare(range(5000, 5016), camera, preparer)
    assert np.mean(figures.overlaps) >= 0.95
    assert figures.half_visible >= 3
    assert figures.missed == []
    assert false_findings(range(6000, 6006), camera, preparer) == 0


def test_the_measure_itself_tells_good_from_bad() -> None:
    scene, other = draw_scene(5000), draw_scene(5001)
    exact = exact_view(scene, 160, 120)
    assert overlap(exact.image, exact.image) == 1.0
    assert overlap(exact.image, exact_view(other, 160, 120).image) < 0.5
    shares = [visible_share(scene, exact_view(scene, 160, 120)) for scene in map(draw_scene, range(5000, 5060))]
    assert max(shares) <= 1.1 and min(shares) == 0.0 and any(0.95 < share <= 1.1 for share in shares)
    # A camera believed to be level that looks down by 5 degrees is told apart from a calibrated one.
    wrong = RgbdPreparer(msgspec.structs.replace(CAMERA.geometry, tilt=0.0))
    assert np.mean(compare(range(5000, 5010), CAMERA, wrong).overlaps) < np.mean(
        compare(range(5000, 5010), CAMERA, PREPARER).overlaps
    )
