"""Columns and the sighting of the other robot, against the exact ray cast."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.perception.scenes import MEDIUM, NARROW, WIDE, Scene, random_scene, visible_share
from vantage.perception.scan import find_other, is_robot_color, scan_columns
from vantage.world.arena import HIDER_COLOR, SEEKER_COLOR
from vantage.world.camera import SURFACE_COLORS, Camera, directions, render
from vantage.world.rays import ROBOT_HIDER, cast_row

NO_BOXES = np.zeros((0, 7))


def pictures(scene: Scene, camera: Camera) -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
    depth, color, _ = scene.messages(camera)
    shape = (camera.height, camera.width)
    return np.frombuffer(depth.data, np.uint16).reshape(shape).copy(), np.frombuffer(color.data, np.uint8).reshape(
        *shape, 3
    ).copy()


def scan(
    camera: Camera, depth: NDArray[np.uint16], color: NDArray[np.uint8], other_color: int = 1
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    k = camera.intrinsics()
    ranges, kinds = np.empty(camera.width), np.empty(camera.width, np.uint8)
    scan_columns(depth, color, k.fx, k.fy, k.cx, k.cy, k.mount_height, other_color, ranges, kinds)
    return ranges, kinds


def exact(scene: Scene, camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Noise-free depth (m) and surface of each column, by the world's own ray cast along the horizon."""
    depths, surfaces = np.empty(camera.width), np.empty(camera.width, np.int64)
    pose = (scene.x, scene.y, scene.heading, scene.other_x, scene.other_y)
    cast_row(directions(camera)[0], 0.08, scene.boxes, 1.2, 1.2, *pose, 1, depths, surfaces)
    return depths, surfaces


def test_one_row_is_taken_as_it_is() -> None:
    depth = np.array([[0, 500, 1, 700, 65535]], np.uint16)
    color = np.array([[SEEKER_COLOR, SEEKER_COLOR, HIDER_COLOR, (120, 120, 118), SEEKER_COLOR]], np.uint8)
    ranges, kinds = np.empty(5), np.empty(5, np.uint8)
    scan_columns(depth, color, 3.0, 3.0, 2.0, 0.0, 0.08, 1, ranges, kinds)
    np.testing.assert_allclose(ranges, [np.nan, 0.5, 0.001, 0.7, np.nan])
    assert kinds.tolist() == [0, 2, 1, 1, 0]
    scan_columns(depth, color, 3.0, 3.0, 2.0, 0.0, 0.08, 0, ranges, kinds)
    assert kinds.tolist() == [0, 1, 2, 1, 0]


@pytest.mark.parametrize("camera", [NARROW, MEDIUM, WIDE], ids=["128x1", "160x120", "640x480"])
def test_ranges_and_kinds_are_those_of_the_ray_cast(camera: Camera) -> None:
    errors, wrong, missing, columns = [], 0, 0, 0
    for seed in range(12):
        scene = random_scene(seed)
        ranges, kinds = scan(camera, *pictures(scene, camera))
        depths, surfaces = exact(scene, camera)
        there = kinds > 0
        errors.append((ranges - depths)[there])
        wrong += int(np.sum((kinds == 2)[there] != (surfaces == ROBOT_HIDER + 1)[there]))
        missing += int(np.sum(~there))
        columns += camera.width
    error = np.concatenate(errors)
    assert abs(np.median(error)) < 0.0005, "biased toward or away from the camera"
    assert np.mean(np.abs(error) > 0.015) < 0.01
    assert wrong <= 0.005 * columns
    assert missing <= (0.08 if camera.height == 1 else 0.02) * columns


def test_the_floor_is_no_surface() -> None:
    # Turned so that the far corner is in view: 1.4 m of floor.
    scene = Scene(NO_BOXES, 0.15, 0.15, math.radians(45.0), math.nan, math.nan, 3)
    for camera in (MEDIUM, WIDE):
        ranges, _ = scan(camera, *pictures(scene, camera))
        np.testing.assert_allclose(ranges, exact(scene, camera)[0], atol=0.02)


def test_flying_pixels_do_not_pull_a_column_closer() -> None:
    generator = np.random.default_rng(5)
    scene = random_scene(21)
    depth, color = pictures(scene, WIDE)
    before, _ = scan(WIDE, depth, color)
    flying = generator.random(depth.shape) < 0.01
    depth[flying] = generator.integers(150, 4000, int(flying.sum()))
    after, _ = scan(WIDE, depth, color)
    assert np.nanmean(np.abs(after - before) > 0.01) < 0.01


def test_drop_outs_leave_a_hole_in_one_row_and_none_in_many() -> None:
    generator = np.random.default_rng(6)
    scene = random_scene(22)
    for camera in (NARROW, MEDIUM):
        depth, color = pictures(scene, camera)
        before, _ = scan(camera, depth, color)
        depth[generator.random(depth.shape) < 0.5] = 0
        after, kinds = scan(camera, depth, color)
        np.testing.assert_array_equal(np.isnan(after), kinds == 0)
        if camera.height == 1:
            np.testing.assert_array_equal(np.isnan(after), depth[0] == 0)
        else:
            assert np.mean(np.isnan(after)) < 0.03
            assert np.nanmedian(np.abs(after - before)) < 0.003


def test_a_low_box_is_found_below_the_horizon() -> None:
    box = np.array([[0.6, 0.6, 0.1, 0.1, 1.0, 0.0, 0.05]])
    scene = Scene(box, 0.2, 0.6, 0.0, math.nan, math.nan, 4)
    for camera in (MEDIUM, WIDE):
        ranges, _ = scan(camera, *pictures(scene, camera))
        assert ranges[camera.width // 2] == pytest.approx(0.3, abs=0.015)
    ranges, _ = scan(NARROW, *pictures(scene, NARROW))
    assert ranges[64] == pytest.approx(1.0, abs=0.015)


@given(st.sampled_from(range(len(SURFACE_COLORS))), st.tuples(*[st.integers(-10, 10)] * 3), st.floats(0.6, 1.1))
@settings(deadline=None, max_examples=300)
def test_the_color_filter_tells_robots_from_all_else(surface: int, noise: tuple[int, int, int], light: float) -> None:
    pixel = [int(min(255, max(0, round(light * c) + n))) for c, n in zip(SURFACE_COLORS[surface], noise, strict=True)]
    for other_color in (0, 1):
        assert is_robot_color(*pixel, other_color) == (surface == ROBOT_HIDER + other_color)


def test_nothing_in_view_is_no_sighting() -> None:
    ranges, kinds = np.full(128, 0.5), np.ones(128, np.uint8)
    seen, whole, x, y = find_other(ranges, kinds, 68.6, 63.5, 0.5, 0.5, 0.0)
    assert seen == 0
    assert not whole
    assert math.isnan(x)
    assert math.isnan(y)


@pytest.mark.parametrize("camera", [NARROW, MEDIUM], ids=["128x1", "160x120"])
def test_the_other_robot_is_found_where_half_of_it_is_visible(camera: Camera) -> None:
    whole_seen = whole_views = 0
    for seed in range(250):
        scene = random_scene(seed)
        share = visible_share(scene, camera)
        perceived = scene.seen_by(camera, draw=False)
        if share == 0.0:
            assert perceived.seen_columns == 0, f"scene {seed}: seen through a box"
        if perceived.whole:
            assert share > 0.9, f"scene {seed}: whole, but only {share:.0%} visible"
        if share >= 0.5:
            assert perceived.other is not None, f"scene {seed}: {share:.0%} visible, not found"
            error = math.hypot(perceived.other[0] - scene.other_x, perceived.other[1] - scene.other_y)
            assert error < (0.010 if perceived.whole else 0.015), f"scene {seed}: {1000 * error:.1f} mm off"
        if share == 1.0:
            whole_views += 1
            whole_seen += perceived.whole
    assert whole_seen >= 0.9 * whole_views > 50


def test_sliver_positions_stay_sensible() -> None:
    for seed in range(400):
        scene = random_scene(seed)
        perceived = scene.seen_by(NARROW, draw=False)
        if perceived.other is not None:
            error = math.hypot(perceived.other[0] - scene.other_x, perceived.other[1] - scene.other_y)
            assert error < 0.065, f"scene {seed}: {perceived.seen_columns} columns, {1000 * error:.1f} mm off"


def test_no_false_sighting_in_a_thousand_empty_views() -> None:
    depth, color = np.zeros((1, 128), np.uint16), np.zeros((1, 128, 3), np.uint8)
    scenes = [random_scene(seed) for seed in range(50)]
    for n in range(1000):
        scene = scenes[n % 50]
        heading = scene.heading + 0.3 * (n // 50)
        render(NARROW, scene.boxes, 1.2, 1.2, scene.x, scene.y, heading, math.nan, math.nan, 1, n, n, 0, depth, color)
        for other_color in (0, 1):
            assert not np.any(scan(NARROW, depth, color, other_color)[1] == 2)
    for scene in scenes[:10]:
        assert scene.without_other().seen_by(MEDIUM, draw=False).seen_columns == 0
