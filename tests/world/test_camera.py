"""The camera against three-dimensional rays, against symmetry, and against its own stated noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.world import reference
from vantage.world import arena
from vantage.world.camera import (
    COLOR_SIGMA,
    DEPTH_SIGMA_AT_ZERO,
    DEPTH_SIGMA_PER_SQUARE_METRE,
    EDGE_DROP_OUT,
    EDGE_JUMP,
    SURFACE_COLORS,
    Camera,
    directions,
    expose,
    render,
)
from vantage.world.layout import boxes_array, make_layout
from vantage.world.motion import box_distance, heading_radians
from vantage.world.rays import BOX_TOP, BOX_X, FLOOR, NOTHING, ROBOT_HIDER, ROBOT_SEEKER, WALL_X, cast_picture, cast_row

SIZE = arena.ARENA_SIZE
ROW = Camera()
NO_BOXES = np.empty((0, 7))
seeds = st.integers(0, 2**40)

Seen = tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]


def exact(
    camera: Camera, boxes: reference.Floats, x: float, y: float, heading: float, other: tuple[float, float] | None, color: int = 1
) -> Seen:
    """Depths and surfaces of the kernels that belong to the camera."""
    rightward, downward = directions(camera)
    depths = np.empty((camera.height, camera.width))
    surfaces = np.empty((camera.height, camera.width), np.int64)
    other_x, other_y = other if other else (math.nan, math.nan)
    pose = (boxes, SIZE, SIZE, x, y, heading, other_x, other_y, color)
    if camera.height == 1:
        cast_row(rightward, camera.mount_height, *pose, depths[0], surfaces[0])
    else:
        cast_picture(rightward, downward, camera.mount_height, *pose, depths, surfaces)
    return depths, surfaces


def picture(
    camera: Camera,
    boxes: reference.Floats,
    place: tuple[float, float, float],
    other: tuple[float, float] = (math.nan, math.nan),
    counters: tuple[int, int, int] = (0, 0, 0),
) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint8]]:
    """Rendered depth and colour; counters are seed, step, robot."""
    depth = np.empty((camera.height, camera.width), np.uint16)
    color = np.empty((camera.height, camera.width, 3), np.uint8)
    render(camera, boxes, SIZE, SIZE, *place, *other, 1, *counters, depth, color)
    return depth, color


def assert_sees(
    camera: Camera, boxes: reference.Floats, x: float, y: float, heading: float, other: tuple[float, float] | None
) -> None:
    depths, surfaces = exact(camera, boxes, x, y, heading, other)
    expected, kinds = reference.view(camera, boxes, x, y, heading, other, 1)
    # The two may part where a ray meets an edge within rounding: hardly any pixel of a large picture, none of a row.
    odd = np.abs(depths - expected) > 1e-7
    assert odd.sum() <= depths.size // 20_000
    base = surfaces & 15
    kind = np.where(base == WALL_X + 1, WALL_X, np.where(base == BOX_X + 1, BOX_X, base))
    # Where a front meets the floor or a top both are there, at one depth.
    assert (kind != kinds)[~odd].sum() <= depths.size // 20_000 + 2


@given(seed=seeds, width=st.integers(1, 200))
@settings(max_examples=60, deadline=None)
def test_a_row_sees_what_rays_in_space_meet(seed: int, width: int) -> None:
    boxes, (x, y, heading), (other_x, other_y, _) = reference.scene(seed)
    assert_sees(Camera(width=width), boxes, x, y, heading_radians(heading) + 1e-3, (other_x, other_y))


@given(seed=seeds, mount=st.floats(0.02, 0.45), tall=st.floats(0.02, 0.35), fov=st.floats(0.3, 2.2))
@settings(max_examples=30, deadline=None)
def test_small_pictures_see_what_rays_in_space_meet_from_any_height(seed: int, mount: float, tall: float, fov: float) -> None:
    boxes, (x, y, heading), (other_x, other_y, _) = reference.scene(seed)
    boxes[:, 6] = (tall, 0.5 * tall, 1.3 * tall)
    camera = Camera(width=64, height=48, mount_height=mount, horizontal_fov=fov)
    assert_sees(camera, boxes, x, y, heading_radians(heading) + 1e-3, (other_x, other_y))


@pytest.mark.parametrize(("seed", "mount"), [(1, 0.08), (2, 0.25), (3, 0.4)])
def test_large_pictures_see_what_rays_in_space_meet(seed: int, mount: float) -> None:
    boxes, (x, y, heading), (other_x, other_y, _) = reference.scene(seed)
    boxes[:, 6] = (0.2, 0.1, 0.05)
    camera = Camera(width=640, height=480, mount_height=mount)
    assert_sees(camera, boxes, x, y, heading_radians(heading) + 1e-3, (other_x, other_y))


@given(seed=seeds, rows=st.integers(1, 12).map(lambda n: 2 * n + 1))
@settings(max_examples=25, deadline=None)
def test_one_row_is_the_middle_row_of_a_tall_picture(seed: int, rows: int) -> None:
    boxes, (x, y, heading), (other_x, other_y, _) = reference.scene(seed)
    tall = replace(ROW, height=rows)
    depths, surfaces = exact(tall, boxes, x, y, heading_radians(heading), (other_x, other_y))
    row_depths, row_surfaces = exact(ROW, boxes, x, y, heading_radians(heading), (other_x, other_y))
    np.testing.assert_array_equal(depths[rows // 2], row_depths[0])
    np.testing.assert_array_equal(surfaces[rows // 2], row_surfaces[0])


@given(seed=seeds)
@settings(max_examples=40, deadline=None)
def test_a_ray_passes_through_nothing_and_ends_on_a_surface(seed: int) -> None:
    boxes, (x, y, heading), (other_x, other_y, _) = reference.scene(seed)
    angle = heading_radians(heading)
    rightward, _ = directions(ROW)
    along = np.stack((math.cos(angle) + math.sin(angle) * rightward, math.sin(angle) - math.cos(angle) * rightward), axis=1)
    depths, surfaces = exact(ROW, boxes, x, y, angle, (other_x, other_y))
    assert (depths > 0.0).all()
    part = np.linspace(0.0, 1.0 - 1e-9, 200)[None, :, None]
    points = np.array([x, y]) + part * (depths[0, :, None] * along)[:, None, :]
    for box in boxes:
        assert not reference.inside(box, points).any()
    assert (np.hypot(points[..., 0] - other_x, points[..., 1] - other_y) > arena.ROBOT_RADIUS - 1e-9).all()
    for u in range(ROW.width):
        end_x, end_y = (x, y) + depths[0, u] * along[u]
        base, index = surfaces[0, u] & 15, surfaces[0, u] >> 4
        if base == ROBOT_SEEKER:
            gap = math.hypot(end_x - other_x, end_y - other_y) - arena.ROBOT_RADIUS
        elif base < BOX_X:
            gap = min(end_x, end_y, SIZE - end_x, SIZE - end_y)
        else:
            gap = box_distance(boxes, index, end_x, end_y)
        assert abs(gap) < 1e-9


@given(seed=seeds, quarters=st.integers(1, 3))
@settings(max_examples=30, deadline=None)
def test_turning_the_arena_leaves_the_view(seed: int, quarters: int) -> None:
    boxes, place, other = reference.scene(seed)
    turned, turned_other = reference.turned_place(*place, quarters), reference.turned_place(*other, quarters)
    before, _ = exact(ROW, boxes, place[0], place[1], heading_radians(place[2]), other[:2])
    after, _ = exact(ROW, reference.turned(boxes, quarters), turned[0], turned[1], heading_radians(turned[2]), turned_other[:2])
    # Near a silhouette a rounding error decides which side a ray passes.
    assert (np.abs(before - after) > 1e-9).sum() <= 1


@given(seed=seeds)
@settings(max_examples=30, deadline=None)
def test_a_mirrored_arena_gives_the_mirrored_view(seed: int) -> None:
    boxes, (x, y, heading), (other_x, other_y, _) = reference.scene(seed)
    mirrored = boxes.copy()
    mirrored[:, 0] = SIZE - boxes[:, 0]
    mirrored[:, 4] = -boxes[:, 4]
    mirrored[:, 3], mirrored[:, 2] = boxes[:, 3], boxes[:, 2]
    before, _ = exact(ROW, boxes, x, y, heading_radians(heading), (other_x, other_y))
    after, _ = exact(ROW, mirrored, SIZE - x, y, heading_radians(18 - heading), (SIZE - other_x, other_y))
    assert (np.abs(before - after[:, ::-1]) > 1e-9).sum() <= 1


def test_rays_parallel_to_walls_and_faces_are_cast() -> None:
    box = np.array([[0.9, 0.6, 0.1, 0.1, 1.0, 0.0, 0.2]])
    for y, expected in ((0.6, 0.5), (0.55, 0.5), (0.75, 0.9)):
        depths, _ = exact(Camera(width=1), box, 0.3, y, 0.0, None)
        assert depths[0, 0] == pytest.approx(expected)
    for y in (0.5, 0.7):  # grazing: either the face or the wall
        depths, _ = exact(Camera(width=1), box, 0.3, y, 0.0, None)
        assert depths[0, 0] == pytest.approx(0.5) or depths[0, 0] == pytest.approx(0.9)


def test_the_robot_ahead_is_as_far_as_its_front() -> None:
    depths, surfaces = exact(Camera(width=129), NO_BOXES, 0.2, 0.6, 0.0, (0.6, 0.6))
    assert depths[0, 64] == pytest.approx(0.4 - arena.ROBOT_RADIUS)
    assert surfaces[0, 64] == ROBOT_SEEKER
    width = (surfaces[0] == ROBOT_SEEKER).sum() / Camera(width=129).intrinsics().fx
    assert width == pytest.approx(2 * math.tan(math.asin(arena.ROBOT_RADIUS / 0.4)), abs=2 / 70)


def test_left_in_the_picture_is_left_of_the_robot() -> None:
    _, surfaces = exact(ROW, NO_BOXES, 0.3, 0.6, 0.0, (0.6, 0.75))
    assert np.flatnonzero(surfaces[0] == ROBOT_SEEKER).max() < ROW.width / 2


def test_low_things_are_looked_over_and_tall_ones_seen_behind_them() -> None:
    boxes = np.array([[0.5, 0.6, 0.05, 0.2, 1.0, 0.0, 0.06], [0.9, 0.6, 0.05, 0.2, 1.0, 0.0, 0.2]])
    depths, _ = exact(Camera(width=1), boxes, 0.2, 0.6, 0.0, None)
    assert depths[0, 0] == pytest.approx(0.65)
    _, surfaces = exact(Camera(width=1, height=2001, horizontal_fov=0.001), boxes, 0.2, 0.6, 0.0, None)
    from_above = list(dict.fromkeys(surfaces[:, 0].tolist()))
    assert from_above == [NOTHING, WALL_X, 16 + BOX_X, BOX_TOP, BOX_X, FLOOR]


def test_above_the_walls_there_is_no_return() -> None:
    camera = Camera(width=64, height=48, noise=False)
    depth, color = picture(camera, NO_BOXES, (0.6, 0.6, 0.0))
    assert (depth[0] == 0).all()
    assert (color[0] == arena.BACKGROUND_COLOR).all()
    assert (color[-1] == arena.FLOOR_COLOR).all()
    _, surfaces = exact(replace(ROW, mount_height=0.35), NO_BOXES, 0.6, 0.6, 0.0, (0.8, 0.6))
    assert (surfaces == NOTHING).all()


@pytest.mark.parametrize("camera", [Camera(noise=False), Camera(64, 48, noise=False), Camera(640, 480, noise=False)])
def test_without_noise_the_picture_is_the_rounded_cast(camera: Camera) -> None:
    boxes, (x, y, heading), (other_x, other_y, _) = reference.scene(7)
    place = (x, y, heading_radians(heading))
    depths, surfaces = exact(camera, boxes, *place, (other_x, other_y))
    depth, color = picture(camera, boxes, place, (other_x, other_y), (5, 6, 1))
    np.testing.assert_array_equal(depth, np.floor(depths * 1000.0 + 0.5).astype(np.uint16))
    np.testing.assert_array_equal(color, SURFACE_COLORS[surfaces & 15])
    np.testing.assert_array_equal(depth, picture(camera, boxes, place, (other_x, other_y), (8, 9, 0))[0])


def test_only_robots_are_saturated() -> None:
    spread = SURFACE_COLORS.max(axis=1) - SURFACE_COLORS.min(axis=1)
    assert (spread[ROBOT_HIDER:] > 120).all()
    assert (spread[:ROBOT_HIDER] < 25).all()


@given(seed=st.integers(0, 2**62), step=st.integers(0, 10_000), robot=st.integers(0, 1))
@settings(max_examples=25, deadline=None)
def test_noise_depends_on_seed_robot_and_step_alone(seed: int, step: int, robot: int) -> None:
    boxes, (x, y, heading), _ = reference.scene(3)
    place = (x, y, heading_radians(heading))
    first = picture(ROW, boxes, place, counters=(seed, step, robot))
    others = [
        picture(ROW, boxes, place, counters=counters)
        for counters in ((seed + 1, step, robot), (seed, step + 1, robot), (seed, step, 1 - robot))
    ]
    again = picture(ROW, boxes, place, counters=(seed, step, robot))
    for part in range(2):
        np.testing.assert_array_equal(first[part], again[part])
        for other in others:
            assert (first[part] != other[part]).mean() > 0.5


@pytest.mark.parametrize("distance", [0.15, 0.5, 1.1])
def test_depth_noise_has_the_stated_size(distance: float) -> None:
    depths = np.full((400, 400), distance)
    depth = np.empty((400, 400), np.uint16)
    color = np.empty((400, 400, 3), np.uint8)
    expose(depths, np.full((400, 400), WALL_X), True, 11, 12, 0, depth, color)
    error = depth * 0.001 - distance
    sigma = DEPTH_SIGMA_AT_ZERO + DEPTH_SIGMA_PER_SQUARE_METRE * distance**2
    quantisation = 0.001 / math.sqrt(12.0)
    assert error.std() == pytest.approx(math.hypot(sigma, quantisation), rel=0.02)
    assert abs(error.mean()) < 3e-5
    assert abs(np.corrcoef(error[:, :-1].ravel(), error[:, 1:].ravel())[0, 1]) < 0.015
    offset = color.astype(float) - SURFACE_COLORS[WALL_X]
    assert offset.std(axis=(0, 1)) == pytest.approx(np.full(3, COLOR_SIGMA), rel=0.03)
    assert np.abs(offset.mean(axis=(0, 1))).max() < 0.05
    assert np.abs(np.corrcoef(offset.reshape(-1, 3).T)[np.triu_indices(3, 1)]).max() < 0.015


@pytest.mark.parametrize("axis", [0, 1])
def test_edges_drop_out_half_the_time_and_nothing_else_does(axis: int) -> None:
    depths = np.full((300, 300), 0.4)
    surfaces = np.full((300, 300), BOX_X)
    behind = (np.arange(300) // 10) % 2 == 1
    index = (behind, slice(None)) if axis == 0 else (slice(None), behind)
    depths[index] = 0.4 + 2 * EDGE_JUMP
    surfaces[index] = WALL_X
    depth = np.empty((300, 300), np.uint16)
    color = np.empty((300, 300, 3), np.uint8)
    expose(depths, surfaces, True, 1, 2, 0, depth, color)
    at_edge = (np.arange(300) % 10 == 0) | (np.arange(300) % 10 == 9)
    at_edge[[0, -1]] = False
    dropped = (depth == 0) if axis == 1 else (depth == 0).T
    assert dropped[:, at_edge].mean() == pytest.approx(EDGE_DROP_OUT, abs=0.02)
    assert not dropped[:, ~at_edge].any()
    depths[index] = 0.4 + 0.5 * EDGE_JUMP
    expose(depths, surfaces, True, 1, 2, 0, depth, color)
    assert (depth > 0).all()


def test_a_steep_surface_does_not_drop_out() -> None:
    depths = np.tile(0.2 + 0.05 * np.arange(20), (20, 1))
    depth = np.empty((20, 20), np.uint16)
    expose(depths, np.full((20, 20), WALL_X), True, 1, 2, 0, depth, np.empty((20, 20, 3), np.uint8))
    assert (depth > 0).all()


def test_intrinsics_span_the_field_of_view() -> None:
    pinhole = Camera(width=640, height=480).intrinsics()
    half = math.radians(43.0)
    assert (639.5 - pinhole.cx) / pinhole.fx == pytest.approx(math.tan(half))
    assert (-0.5 - pinhole.cx) / pinhole.fx == pytest.approx(-math.tan(half))
    assert pinhole.fy == pinhole.fx
    assert Camera().intrinsics().cy == 0.0


def test_arrays_that_do_not_fit_and_cameras_that_cannot_be_are_refused() -> None:
    depth, color = np.empty((2, 128), np.uint16), np.empty((1, 128, 3), np.uint8)
    with pytest.raises(ValueError, match="128 x 1 camera needs"):
        render(ROW, NO_BOXES, SIZE, SIZE, 0.5, 0.5, 0.0, math.nan, math.nan, 1, 0, 0, 0, depth, color)
    for wrong in ({"width": 0}, {"height": 5000}, {"horizontal_fov": math.pi}, {"mount_height": 0.0}, {"mount_height": math.nan}):
        with pytest.raises(ValueError):
            Camera(**wrong)  # type: ignore[arg-type]


def test_a_camera_outside_the_arena_or_in_a_box_sees_nothing_rather_than_nonsense() -> None:
    boxes = boxes_array(make_layout("lab", 0))
    for x, y in ((-0.1, 0.5), (1.5, 1.5), (boxes[0, 0], boxes[0, 1])):
        depths, _ = exact(ROW, boxes, x, y, 1.0, None)
        assert ((depths >= 0.0) & (depths < 4.0)).all()
