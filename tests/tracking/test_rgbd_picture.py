"""The rendered RGB-D camera: against the renderer of the simulation, and its errors against what they are said to be."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from vantage.rehearsal.rgbd_picture import RgbdCamera, RgbdLook, render_rgbd
from vantage.tracking.rgbd import RgbdCalibration, default_rgbd
from vantage.tracking.rgbd_lens import lens_of
from vantage.world.arena import HIDER_COLOR
from vantage.world.camera import DEPTH_SIGMA_AT_ZERO, DEPTH_SIGMA_PER_SQUARE_METRE, SURFACE_COLORS, Camera, directions
from vantage.world.layout import boxes_array, make_layout
from vantage.world.rays import BOX_STRIDE, cast_picture

EXACT = RgbdLook(noise=0.0, edge_drop_out=0.0, flying=0.0, holes=0.0, unevenness=0.0)
LEVEL = RgbdCalibration(depth=lens_of(320, 240, math.radians(86.0)), color=lens_of(320, 240, math.radians(86.0)))
NO_BOXES = np.zeros((0, 7))


def _simulated(
    boxes: np.ndarray, x: float, y: float, heading: float, other: tuple[float, float], color: int
) -> tuple[np.ndarray, np.ndarray]:
    rightward, downward = directions(Camera(width=320, height=240))
    depths, surfaces = np.empty((240, 320)), np.empty((240, 320), np.int64)
    cast_picture(rightward, downward, 0.08, boxes, 1.2, 1.2, x, y, heading, *other, color, depths, surfaces)
    return depths, surfaces


@pytest.mark.parametrize("seed", range(12))
def test_a_level_camera_sees_what_the_simulation_renders(seed: int) -> None:
    generator = np.random.default_rng(seed)
    boxes = boxes_array(make_layout("random", seed))
    x, y, heading = generator.uniform(0.1, 1.1), generator.uniform(0.1, 1.1), generator.uniform(-3.1, 3.1)
    distance, bearing = generator.uniform(0.1, 0.5), heading + generator.uniform(-1.2, 1.2)
    other = (x + distance * math.cos(bearing), y + distance * math.sin(bearing))
    depth, color = render_rgbd(RgbdCamera(LEVEL, EXACT), boxes, (x, y, heading), other, seed % 2, 1, 0, 0)
    expected, surfaces = _simulated(boxes, x, y, heading, other, seed % 2)
    off = np.abs(depth - 1000.0 * expected) > 0.51 + 1e-3
    assert np.mean(off) < 0.002  # single precision decides edges otherwise
    strange = np.any(color != SURFACE_COLORS[surfaces % BOX_STRIDE], axis=2)
    assert np.mean(strange) < 0.002


def test_each_lens_stands_where_the_calibration_says() -> None:
    geometry = msgspec.structs.replace(LEVEL, translation=(-0.02, 0.0, 0.0), forward=0.03, left=0.01)
    boxes = boxes_array(make_layout("lab", 0))
    x, y, heading, other = 0.6, 0.6, 0.5, (0.9, 0.65)
    depth, color = render_rgbd(RgbdCamera(geometry, EXACT), boxes, (x, y, heading), other, 0, 1, 0, 0)
    cosine, sine = math.cos(heading), math.sin(heading)
    lens_x, lens_y = x + 0.03 * cosine - 0.01 * sine, y + 0.03 * sine + 0.01 * cosine
    expected, _ = _simulated(boxes, lens_x, lens_y, heading, other, 0)
    assert np.mean(np.abs(depth - 1000.0 * expected) > 0.52) < 0.002
    _, surfaces = _simulated(boxes, lens_x + 0.02 * sine, lens_y - 0.02 * cosine, heading, other, 0)
    assert np.mean(np.any(color != SURFACE_COLORS[surfaces % BOX_STRIDE], axis=2)) < 0.002
    assert np.any(np.all(color == HIDER_COLOR, axis=2))


def test_a_tilted_camera_sees_the_floor_where_trigonometry_puts_it() -> None:
    tilt = math.radians(20.0)
    geometry = msgspec.structs.replace(LEVEL, tilt=tilt, depth_unit=0.0001)
    depth, _ = render_rgbd(RgbdCamera(geometry, EXACT), NO_BOXES, (0.1, 0.6, 0.0), None, 0, 1, 0, 0)
    lens = geometry.depth
    for row in (150, 180, 220):
        below = (row - lens.cy) / lens.fy
        # Along the axis: the ray falls by sin(tilt) + below cos(tilt) a unit of depth.
        assert 0.0001 * depth[row, 160] == pytest.approx(0.08 / (math.sin(tilt) + below * math.cos(tilt)), abs=1e-4)


def test_noise_grows_with_range_and_is_as_large_as_said() -> None:
    camera = RgbdCamera(LEVEL, RgbdLook(holes=0.0, edge_drop_out=0.0, flying=0.0))
    for x in (0.9, 0.2):
        exact = 1000.0 * (1.2 - x)
        errors = []
        for frame in range(12):
            depth, _ = render_rgbd(camera, NO_BOXES, (x, 0.6, 0.0), None, 0, 1, frame, 0)
            errors.append(depth[118:122, 100:220].astype(float) - exact)
        z = 1.2 - x
        expected = 1000.0 * (DEPTH_SIGMA_AT_ZERO + DEPTH_SIGMA_PER_SQUARE_METRE * z * z)
        assert np.std(errors) == pytest.approx(expected, rel=0.12)
        assert abs(np.mean(errors)) < 0.3


def test_holes_and_drop_outs_take_the_share_they_are_said_to() -> None:
    pose, other = (0.2, 0.6, 0.0), (0.6, 0.6)
    whole = render_rgbd(RgbdCamera(LEVEL, EXACT), NO_BOXES, pose, other, 0, 1, 0, 0)[0]
    look = RgbdLook(noise=0.0, edge_drop_out=0.0, flying=0.0, holes=0.05)
    shares = [
        np.mean(render_rgbd(RgbdCamera(LEVEL, look), NO_BOXES, pose, other, 0, 1, n, 0)[0][whole > 0] == 0) for n in range(8)
    ]
    assert 0.035 < np.mean(shares) < 0.06
    look = RgbdLook(noise=0.0, edge_drop_out=1.0, holes=0.0)
    torn = render_rgbd(RgbdCamera(LEVEL, look), NO_BOXES, pose, other, 0, 1, 0, 0)[0]
    dropped = (torn == 0) & (whole > 0)
    jump = np.abs(np.diff(whole.astype(int), axis=1)) > 35
    beside = np.zeros_like(dropped)
    beside[:, 1:] |= jump
    beside[:, :-1] |= jump
    robot = slice(105, 130)  # rows where its sides stand before the wall
    assert np.count_nonzero(dropped[robot]) >= 100
    assert np.mean(dropped[robot] == (beside[robot] & (whole[robot] > 0))) > 0.995


def test_flying_pixels_lie_between_two_surfaces_beside_an_edge() -> None:
    pose, other = (0.2, 0.6, 0.0), (0.6, 0.6)
    whole = render_rgbd(RgbdCamera(LEVEL, EXACT), NO_BOXES, pose, other, 0, 1, 0, 0)[0]
    look = RgbdLook(noise=0.0, edge_drop_out=0.0, flying=0.5, holes=0.0)
    depth = render_rgbd(RgbdCamera(LEVEL, look), NO_BOXES, pose, other, 0, 1, 0, 0)[0]
    rows = slice(105, 130)  # where the robot's sides stand before the wall: two edges, two pixels each
    strange = depth[rows] != whole[rows]
    assert 0.35 < np.count_nonzero(strange) / (4 * 25) < 0.65
    values = depth[rows][strange]
    assert np.all((values >= 335) & (values <= 1000)) and np.ptp(values) > 400


def test_a_stereo_shadow_lies_to_the_left_of_what_is_near() -> None:
    look = RgbdLook(noise=0.0, edge_drop_out=0.0, flying=0.0, holes=0.0, stereo_baseline=0.05)
    depth, _ = render_rgbd(RgbdCamera(LEVEL, look), NO_BOXES, (0.2, 0.6, 0.0), (0.6, 0.6), 0, 1, 0, 0)
    row = depth[120]
    columns = np.flatnonzero((row > 300) & (row < 420))
    first, last = columns[0], columns[-1]
    width = LEVEL.depth.fx * 0.05 * (1.0 / 0.37 - 1.0 / 1.0)
    dark = np.flatnonzero(row[:first] == 0)
    assert len(dark) == pytest.approx(width, abs=4) and dark[-1] == first - 1
    assert np.all(row[last + 1 : last + 20] > 0)


def test_light_scales_and_falls_off() -> None:
    look = RgbdLook(noise=0.0, red_gain=0.5, brightness=0.8, unevenness=0.2)
    _, color = render_rgbd(RgbdCamera(LEVEL, look), NO_BOXES, (0.6, 0.6, math.pi / 2), (0.6, 0.9), 0, 1, 0, 0)
    middle = color[118:122, 158:162].reshape(-1, 3).mean(axis=0)
    assert middle == pytest.approx(np.array(HIDER_COLOR) * (0.4, 0.8, 0.8), abs=1.0)
    assert color[60, 20, 2] > 1.1 * color[60, 299, 2]  # the left wall is nearer the light


def test_pictures_depend_on_the_counters_only() -> None:
    camera = RgbdCamera(LEVEL)
    counters = ((1, 0, 0), (1, 1, 0), (1, 0, 1), (2, 0, 0), (1, 0, 0))
    views = [render_rgbd(camera, NO_BOXES, (0.2, 0.6, 0.0), (0.6, 0.6), 1, *each) for each in counters]
    assert all(np.array_equal(a, b) for a, b in zip(views[0], views[4], strict=True))
    for other in views[1:4]:
        assert not any(np.array_equal(a, b) for a, b in zip(views[0], other, strict=True))


def test_absurd_looks_and_mounts_are_refused() -> None:
    for look in (
        {"noise": -1.0},
        {"edge_drop_out": 2.0},
        {"flying": -0.1},
        {"holes": math.nan},
        {"brightness": -1.0},
        {"unevenness": 1.5},
    ):
        with pytest.raises(ValueError, match="must be"):
            RgbdLook(**look)
    upwards = msgspec.structs.replace(default_rgbd(), tilt=-0.8, depth=lens_of(640, 480, math.radians(120.0)))
    with pytest.raises(ValueError, match="tilt it less"):
        render_rgbd(RgbdCamera(upwards), NO_BOXES, (0.2, 0.6, 0.0), None, 0, 1, 0, 0)
