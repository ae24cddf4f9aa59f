from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.tracking.overhead_scene import LAB, ROBOTS, calibration, picture, scene
from vantage.rehearsal.overhead_picture import rehearsal_camera
from vantage.tracking.overhead_camera import OverheadCamera
from vantage.tracking.tag_pose import measure_pose, mounted_corners
from vantage.tracking.tag_search import SearchPlan, clipped, tiles_of
from vantage.tracking.tags import FoundTag, TagFinder, distinct, tag_cells

WHOLE = (0, 0, 1280, 720)


@pytest.mark.parametrize("tag", [0, 1, 23, 586])
def test_an_upright_tag_is_found_upright_and_exactly(tag: int) -> None:
    drawn = np.pad(np.kron(tag_cells(tag), np.ones((6, 6), np.uint8)), 20, constant_values=128)
    drawn = cv2.GaussianBlur(drawn, (0, 0), 0.8)
    (found,) = TagFinder().find(drawn, (0, 0, *drawn.shape[::-1]), half=False)
    low, high = 20 + 6 - 0.5, 20 + 54 - 0.5  # edges of the black square; integers are pixel centres
    assert found.id == tag
    assert found.corners == pytest.approx(np.array([[low, high], [high, high], [high, low], [low, low]]), abs=0.2)
    assert found.centre == pytest.approx([(low + high) / 2] * 2, abs=0.2)
    assert found.width == pytest.approx(48, abs=0.3)


@pytest.mark.parametrize("half", [False, True])
def test_all_tags_of_a_rendered_table_are_found_to_a_tenth_of_a_pixel(half: bool) -> None:
    found = {tag.id: tag.corners for tag in TagFinder().find(picture(), WHOLE, half)}
    truth = scene().true_corners(ROBOTS, LAB)
    assert sorted(found) == sorted(truth) == [0, 1, 10, 11, 12, 20, 21, 22, 23]
    errors = np.stack([found[tag] - truth[tag] for tag in truth])
    assert np.sqrt((errors**2).mean()) < 0.12
    assert np.abs(errors.mean(axis=(0, 1))).max() < 0.03


def test_windows_give_the_coordinates_of_the_whole_picture_grey_or_coloured() -> None:
    seen, finder = picture(), TagFinder()
    truth = scene().true_corners(ROBOTS, LAB)[0].mean(axis=0)
    grey = cv2.cvtColor(seen, cv2.COLOR_RGB2GRAY)
    for shift in (0, 7):
        window = clipped(truth[0] + shift, truth[1], 55, 1280, 720)
        for shown in (seen, grey):
            (found,) = finder.find(shown, window, True)
            assert found.centre == pytest.approx(truth, abs=0.15)
    assert finder.find(seen, (0, 0, 10, 700), True) == []
    assert finder.find(seen, (300, 200, 200, 100), True) == []


def test_what_is_found_twice_at_one_place_counts_once() -> None:
    square = np.array([[0.0, 10], [10, 10], [10, 0], [0, 0]])
    tags = [FoundTag(1, square, 60), FoundTag(1, square + 1, 60), FoundTag(1, square + 40, 60), FoundTag(2, square, 60)]
    assert [(tag.id, tag.corners[0, 0]) for tag in distinct(tags)] == [(1, 0), (1, 40), (2, 0)]


@settings(max_examples=100, deadline=None)
@given(
    st.tuples(st.floats(0.0, 1.2), st.floats(0.0, 1.2), st.floats(-math.pi, math.pi)),
    st.tuples(st.floats(-0.04, 0.04), st.floats(-0.04, 0.04), st.floats(-math.pi, math.pi)),
    st.floats(0.0, 0.4),
    st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
)
def test_a_projected_pose_is_measured_again(
    pose: tuple[float, float, float], mount: tuple[float, float, float], height: float, tilt: tuple[float, float]
) -> None:
    """Brute force: carry the tag's corners by hand, project them, and ask for the pose."""
    camera = OverheadCamera(rehearsal_camera(tilt=tilt))
    x, y, heading = pose
    rows = []
    for across, up in ((-0.03, -0.03), (0.03, -0.03), (0.03, 0.03), (-0.03, 0.03)):
        forward = mount[0] + math.cos(mount[2]) * across - math.sin(mount[2]) * up
        left = mount[1] + math.sin(mount[2]) * across + math.cos(mount[2]) * up
        rows.append(
            (
                *(x + math.cos(heading) * forward - math.sin(heading) * left,),
                *(y + math.sin(heading) * forward + math.cos(heading) * left, height),
            )
        )
    measured = measure_pose(camera, camera.project(np.array(rows)), mounted_corners(0.06, *mount), height, 0.1)
    assert measured.pose[:2] == pytest.approx((x, y), abs=1e-5)
    assert math.remainder(measured.pose[2] - heading, math.tau) == pytest.approx(0.0, abs=1e-4)
    assert measured.scale == pytest.approx(1.0, abs=1e-3) and measured.residual < 1e-5


def test_covariance_is_what_noise_in_the_corners_makes() -> None:
    """Against 4,000 noisy measurements; the tag sits 40 mm off the robot's centre, so place and heading go together."""
    camera, random = OverheadCamera(calibration()), np.random.default_rng(2)
    mounted = mounted_corners(0.06, 0.04, -0.01, 0.3)
    cosine, sine = math.cos(0.8), math.sin(0.8)
    carried = mounted @ np.array([[cosine, sine], [-sine, cosine]]) + np.array([0.2, 0.9])
    corners = camera.project(np.column_stack((carried, np.full(4, 0.13))))
    drawn = np.stack(
        [measure_pose(camera, corners + 0.2 * random.standard_normal((4, 2)), mounted, 0.13, 0.2).pose for _ in range(4000)]
    )
    expected = measure_pose(camera, corners, mounted, 0.13, 0.2).covariance
    scale = np.sqrt(np.diag(expected))
    assert np.cov(drawn.T) / np.outer(scale, scale) == pytest.approx(expected / np.outer(scale, scale), abs=0.1)


def test_tiles_hold_every_small_square_whole() -> None:
    tiles = tiles_of(1280, 720, 90)
    random = np.random.default_rng(0)
    for left, top in random.integers((0, 0), (1280 - 90, 720 - 90), (2000, 2)):
        assert any(a <= left and b <= top and left + 90 <= c and top + 90 <= d for a, b, c, d in tiles)
    assert max((c - a) * (d - b) for a, b, c, d in tiles) < 0.14 * 1280 * 720


def test_searches_come_in_time_and_not_too_often() -> None:
    plan = SearchPlan(tiles_of(1280, 720, 90), 2.0, 0.3)
    assert plan.whole_due(0, urgent=False)
    completed, tiles = [], 0
    for frame in range(1, 301):
        assert not plan.whole_due(frame * 33_333_333, urgent=False)
        tile, completes = plan.tile_due(frame * 33_333_333)
        tiles += tile is not None
        completed += [frame] * completes
    assert len(completed) == 4 and tiles >= 4 * 12
    urgent = sum(plan.whole_due(10**10 + frame * 33_333_333, urgent=True) for frame in range(90))
    assert 9 <= urgent <= 11
    assert plan.whole_due(0, urgent=False), "a clock that goes backwards starts anew"
