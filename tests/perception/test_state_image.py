"""The state image, against brute-force visibility and by its properties."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.perception.scenes import (
    MEDIUM,
    NARROW,
    WIDE,
    Scene,
    disc,
    ideally_visible,
    overlap,
    pixel_centers,
    random_scene,
)
from vantage.perception.action_maps import transform_image, transform_path
from vantage.perception.palette import (
    BOUNDARY,
    FREE,
    INVISIBLE,
    OTHER,
    OWN,
    PALETTE,
    PIXEL_SIZE,
    from_rgb,
    to_rgb,
    view_for_people,
    view_palette,
)
from vantage.perception.scan import find_other, scan_columns
from vantage.perception.state_image import draw, perceive
from vantage.world.arena import ROBOT_COLORS
from vantage.world.camera import Camera

K = NARROW.intrinsics()


def image_of(
    ranges: NDArray[np.float64],
    kinds: NDArray[np.uint8],
    pose: tuple[float, float, float],
    other: tuple[float, float] | None = None,
    camera: Camera = NARROW,
) -> NDArray[np.uint8]:
    image = np.full((128, 128), 99, np.uint8)
    k = camera.intrinsics()
    other_x, other_y = other or (math.nan, math.nan)
    draw(ranges, kinds, k.fx, k.cx, *pose, other is not None, other_x, other_y, image)
    return image


def visible(image: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return (image == FREE) | (image == BOUNDARY)


@st.composite
def views(draw_value: st.DrawFn) -> tuple[NDArray[np.float64], NDArray[np.uint8], tuple[float, float, float]]:
    """Any columns a camera might deliver, from anywhere in the arena."""
    seed = draw_value(st.integers(0, 2**32))
    generator = np.random.default_rng(seed)
    pieces = draw_value(st.integers(1, 40))
    ranges = generator.uniform(0.03, 2.0, pieces)[np.sort(generator.integers(0, pieces, 128))] + generator.normal(0, 0.004, 128)
    kinds = generator.choice(np.array([0, 1, 1, 1, 2], np.uint8), pieces)[np.sort(generator.integers(0, pieces, 128))]
    kinds[generator.random(128) < draw_value(st.sampled_from([0.0, 0.1, 0.5, 1.0]))] = 0
    ranges[kinds == 0] = np.nan
    x, y = generator.uniform(0.0, 1.2, 2)
    return np.abs(ranges), kinds, (float(x), float(y), float(generator.uniform(-math.pi, math.pi)))


def column_and_depth(pose: tuple[float, float, float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of every pixel's centre: the fractional column that sees it, and its depth along the optical axis, m."""
    x, y = pixel_centers()
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    ahead = (x - pose[0]) * cosine + (y - pose[1]) * sine
    right = (x - pose[0]) * sine - (y - pose[1]) * cosine
    with np.errstate(divide="ignore", invalid="ignore"):
        return K.cx + K.fx * right / ahead, ahead


def test_visible_area_is_that_of_brute_force_rays() -> None:
    fine = Camera(width=1024, height=1, noise=False)
    for camera, least_mean, least in ((fine, 0.985, 0.96), (replace(NARROW, noise=False), 0.97, 0.93)):
        overlaps = []
        for seed in range(40):
            scene = random_scene(seed)
            ideal = ideally_visible(scene)
            discs = disc(scene.x, scene.y) | disc(scene.other_x, scene.other_y)
            image = scene.seen_by(camera).image
            if np.sum(ideal & ~discs) > 800:
                overlaps.append(overlap(visible(image) & ~discs, ideal & ~discs))
        assert len(overlaps) > 25
        assert np.mean(overlaps) >= least_mean
        assert min(overlaps) >= least


def test_cameras_agree_in_spite_of_noise() -> None:
    for camera in (NARROW, MEDIUM):
        overlaps = []
        for seed in range(40, 70):
            scene = random_scene(seed)
            fine, coarse = visible(scene.seen_by(WIDE).image), visible(scene.seen_by(camera).image)
            if fine.sum() > 800:
                overlaps.append(overlap(fine, coarse))
        assert len(overlaps) > 20
        assert np.mean(overlaps) >= 0.97
        assert min(overlaps) >= 0.93


@given(views())
@settings(deadline=None, max_examples=150)
def test_nothing_is_free_beyond_the_end_of_its_column(view: tuple) -> None:
    ranges, kinds, pose = view
    image = image_of(ranges, kinds, pose)
    assert set(np.unique(image)) <= {INVISIBLE, FREE, BOUNDARY, OWN}
    column, depth = column_and_depth(pose)
    free = image == FREE
    assert np.all(depth[free] > -PIXEL_SIZE)
    # A pixel may see up to two columns aside, over a bridged hole, to a shorter or a longer end.
    known = np.where(kinds == 0, -np.inf, ranges)
    reach = np.array([known[max(0, u - 3) : u + 4].max() for u in range(128)])
    u = np.clip(np.rint(column[free]), 0, 127).astype(int)
    assert np.all(depth[free] <= reach[u] + PIXEL_SIZE)


@given(views())
@settings(deadline=None, max_examples=150)
def test_all_is_visible_nearer_than_the_columns_around(view: tuple) -> None:
    ranges, kinds, pose = view
    image = image_of(ranges, kinds, pose)
    column, depth = column_and_depth(pose)
    nearest = np.array([np.where(kinds == 0, 0.0, ranges)[max(0, u - 1) : u + 2].min() for u in range(128)])
    inside = (depth > 0) & (column > 0) & (column < 127)
    # Between two columns that leave the arena through different walls the corner is cut off.
    inside[[0, 1, 2, 3, -4, -3, -2, -1], :] = inside[:, [0, 1, 2, 3, -4, -3, -2, -1]] = False
    u = np.clip(np.rint(column), 0, 127)
    u = np.where(np.isfinite(u), u, 0).astype(int)
    assert np.all(image[inside & (depth < nearest[u] - 1e-9)] != INVISIBLE)


@given(views(), st.tuples(st.floats(-0.3, 1.5), st.floats(-0.3, 1.5)))
@settings(deadline=None, max_examples=60)
def test_the_other_disc_is_drawn_only_where_sighted(view: tuple, other: tuple[float, float]) -> None:
    ranges, kinds, pose = view
    without, with_other = image_of(ranges, kinds, pose), image_of(ranges, kinds, pose, other)
    assert not np.any(without == OTHER)
    own = disc(pose[0], pose[1])
    np.testing.assert_array_equal(without == OWN, own)
    np.testing.assert_array_equal(with_other == OTHER, disc(*other) & ~own)
    np.testing.assert_array_equal(with_other[with_other != OTHER], without[with_other != OTHER])


@given(views(), st.integers(0, 7))
@settings(deadline=None, max_examples=100)
def test_symmetries_of_the_square_commute_with_drawing(view: tuple, k: int) -> None:
    ranges, kinds, pose = view
    other = (0.37, 0.83)
    turned = np.empty((128, 128), np.uint8)
    transform_image(image_of(ranges, kinds, pose, other), k, turned)
    if k >= 4:
        ranges, kinds = ranges[::-1].copy(), kinds[::-1].copy()
    x, y, heading = transform_path(np.array(pose), k)
    other_x, other_y = transform_path(np.array(other), k)
    # Rounding may tip a pixel whose centre, or whose border, lies exactly on an edge.
    assert np.sum(turned != image_of(ranges, kinds, (x, y, heading), (other_x, other_y))) <= 6


def test_walls_are_boundary_and_the_disc_is_fourteen_pixels() -> None:
    scene = Scene(np.zeros((0, 7)), 0.6, 0.6, 0.0, math.nan, math.nan, 1)
    for turns, edge in ((0, np.s_[:, 127]), (1, np.s_[0, :]), (2, np.s_[:, 0]), (3, np.s_[127, :])):
        image = replace(scene, heading=turns * math.pi / 2).seen_by(replace(NARROW, noise=False)).image
        assert np.sum(image[edge] == BOUNDARY) > 115
        assert np.sum(image == BOUNDARY) < 140
    own = np.argwhere(image == OWN)
    assert np.all(np.ptp(own, axis=0) + 1 == 14)
    np.testing.assert_allclose(own.mean(axis=0), 63.5)


def test_nothing_is_visible_behind_the_other_robot() -> None:
    checked = 0
    for seed in range(40):
        scene = random_scene(seed)
        perceived = scene.seen_by(NARROW)
        if not perceived.whole:
            continue
        checked += 1
        x, y = pixel_centers()
        middle = math.atan2(scene.other_y - scene.y, scene.other_x - scene.x)
        distance = math.hypot(scene.other_x - scene.x, scene.other_y - scene.y)
        away = np.arctan2(y - scene.y, x - scene.x) - middle
        shadow = np.abs(np.arctan2(np.sin(away), np.cos(away))) < 0.75 * math.asin(0.065 / distance)
        shadow &= (np.hypot(x - scene.x, y - scene.y) > distance) & ~disc(*perceived.other)
        assert np.all(perceived.image[shadow] == INVISIBLE)
        assert np.sum(perceived.image == OTHER) > 140
    assert checked > 10


def test_small_holes_are_bridged_and_large_ones_stay_unknown() -> None:
    pose = (0.1, 0.6, 0.0)
    ranges, kinds = np.full(128, 0.8), np.ones(128, np.uint8)
    whole = image_of(ranges, kinds, pose)
    for hole, same in ((1, True), (2, True), (3, False), (8, False)):
        holed, holed_kinds = ranges.copy(), kinds.copy()
        holed[60 : 60 + hole] = np.nan
        holed_kinds[60 : 60 + hole] = 0
        image = image_of(holed, holed_kinds, pose)
        assert np.array_equal(image, whole) == same
    column, depth = column_and_depth(pose)
    assert np.all(image[(depth > 0) & (column > 60) & (column < 67) & ~disc(0.1, 0.6)] == INVISIBLE)


def test_a_hole_at_an_edge_is_shared_by_its_two_sides() -> None:
    pose = (0.1, 0.6, 0.0)
    ranges, kinds = np.full(128, 0.9), np.ones(128, np.uint8)
    ranges[:64] = 0.3
    sharp = image_of(ranges, kinds, pose)
    ranges[63:65] = np.nan
    kinds[63:65] = 0
    assert overlap(visible(sharp), visible(image_of(ranges, kinds, pose))) > 0.99


def test_a_robot_beside_the_arena_is_drawn_without_harm() -> None:
    generator = np.random.default_rng(0)
    for _ in range(300):
        pose = tuple(generator.uniform(-3.0, 4.0, 3))
        ranges = generator.uniform(0.001, 70.0, 128)
        image = image_of(ranges, np.ones(128, np.uint8), pose, tuple(generator.uniform(-3.0, 4.0, 2)))
        assert image.max() <= OTHER
    image = image_of(np.full(128, np.nan), np.zeros(128, np.uint8), (100.0, -100.0, 7.0))
    assert np.all(image == INVISIBLE)


@pytest.mark.parametrize("camera", [NARROW, MEDIUM], ids=["128x1", "160x120"])
@pytest.mark.parametrize("robot", ["hider", "seeker"])
def test_perceive_is_its_kernels_in_order(camera: Camera, robot: str) -> None:
    for seed in range(8):
        depth, color, pose = random_scene(seed).messages(camera)
        perceived = perceive(depth, color, pose, robot)
        k = camera.intrinsics()
        ranges, kinds, image = np.empty(camera.width), np.empty(camera.width, np.uint8), np.empty((128, 128), np.uint8)
        shape = (camera.height, camera.width)
        scan_columns(
            np.frombuffer(depth.data, np.uint16).reshape(shape),
            np.frombuffer(color.data, np.uint8).reshape(*shape, 3),
            k.fx,
            k.fy,
            k.cx,
            k.cy,
            k.mount_height,
            1 if robot == "hider" else 0,
            ranges,
            kinds,
        )
        seen, whole, x, y = find_other(ranges, kinds, k.fx, k.cx, pose.x, pose.y, pose.heading)
        draw(ranges, kinds, k.fx, k.cx, pose.x, pose.y, pose.heading, seen >= 2, x, y, image)
        np.testing.assert_array_equal(perceived.image, image)
        np.testing.assert_array_equal(perceived.ranges, ranges)
        np.testing.assert_array_equal(perceived.kinds, kinds)
        assert (perceived.seen_columns, perceived.whole) == (seen, whole)
        assert perceived.other == ((x, y) if seen >= 2 else None)
        if robot == "seeker":
            assert seen == 0, "the scene's other robot wears the seeker's colour"
        undrawn = perceive(depth, color, pose, robot, draw=False)
        assert undrawn.image.size == 0
        assert undrawn.other == perceived.other


def test_pictures_of_different_size_are_refused() -> None:
    scene = random_scene(1)
    depth, _, pose = scene.messages(NARROW)
    _, color, _ = scene.messages(MEDIUM)
    with pytest.raises(ValueError, match="colour \\(160 x 120\\) must be registered to depth \\(128 x 1\\)"):
        perceive(depth, color, pose, "hider")


def test_other_principal_points_and_a_single_column_work() -> None:
    depth, color, pose = random_scene(3).messages(Camera(width=1, height=1, noise=False))
    assert perceive(depth, color, pose, "hider").ranges.shape == (1,)
    depth, color, pose = random_scene(3).messages(NARROW)
    shifted = msgspec.structs.replace(depth.intrinsics, cx=0.0)
    moved = perceive(msgspec.structs.replace(depth, intrinsics=shifted), color, pose, "hider")
    assert np.sum(moved.image == OWN) > 100


def test_people_see_each_robot_in_one_colour_whoever_looks_and_networks_see_what_they_were_trained_on() -> None:
    assert PALETTE.tolist() == [[0, 0, 255], [255, 255, 255], [0, 0, 0], [0, 255, 0], [255, 0, 0]]
    for looking, other in (("hider", "seeker"), ("seeker", "hider")):
        seen = view_palette(looking)  # type: ignore[arg-type]
        assert (tuple(seen[OWN]), tuple(seen[OTHER])) == (ROBOT_COLORS[looking], ROBOT_COLORS[other])  # type: ignore[index]
        np.testing.assert_array_equal(seen[:OWN], PALETTE[:OWN])
        np.testing.assert_array_equal(view_for_people(PALETTE, looking), seen)  # type: ignore[arg-type]
    blurred = view_for_people(np.array([255, 128, 128], np.uint8), "seeker").astype(int)  # half the hider on free floor
    assert blurred[1] > max(blurred[0], blurred[2]) + 50


def test_colors_and_indices_are_each_others_inverse() -> None:
    image = random_scene(7).seen_by(NARROW).image
    colors = to_rgb(image)
    assert colors.shape == (128, 128, 3)
    np.testing.assert_array_equal(from_rgb(colors), image)
    np.testing.assert_array_equal(from_rgb(0.8 * colors + 25.0), image)
    assert len({tuple(color) for color in PALETTE}) == 5
