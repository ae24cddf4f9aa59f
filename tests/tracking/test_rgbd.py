"""Preparing RGB-D pictures: against a plain reference, its properties, and what it refuses."""

from __future__ import annotations

import math
import resource
import signal
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vantage.perception.scan import is_robot_color
from vantage.rehearsal.rgbd_picture import RgbdCamera, RgbdLook, render_rgbd
from vantage.tracking.colors import ColorCorrection
from vantage.tracking.rgbd import (
    RgbdCalibration,
    RgbdPreparer,
    UnusableRgbdCalibration,
    coverage,
    default_rgbd,
    load_rgbd,
    prepare,
    save_rgbd,
)
from vantage.tracking.rgbd_kernels import BLOCK, HIDDEN, surface_band
from vantage.tracking.rgbd_lens import Lens, lens_of, pixel_rays, project
from vantage.world.arena import SEEKER_COLOR

EXACT = RgbdLook(noise=0.0, edge_drop_out=0.0, flying=0.0, holes=0.0, unevenness=0.0)
NO_BOXES = np.zeros((0, 7))


def _rotation(x: float, y: float, z: float) -> tuple[float, ...]:
    return tuple(map(float, cv2.Rodrigues(np.array([x, y, z]))[0].ravel()))


SMALL = RgbdCalibration(
    depth=msgspec.structs.replace(lens_of(160, 120, math.radians(87.0)), cx=77.0, distortion=(-0.04, 0.01, 0.001, -0.002, 0.0)),
    color=msgspec.structs.replace(lens_of(200, 144, math.radians(80.0)), cy=75.0, distortion=(-0.06, 0.02, -0.001, 0.001, 0.003)),
    rotation=_rotation(0.01, -0.02, 0.015),
    translation=(-0.02, 0.003, 0.004),
    mount_height=0.085,
    tilt=math.radians(8.0),
    forward=0.015,
    left=0.01,
    depth_unit=0.0005,
    correction=ColorCorrection(matrix=(0.9, 0.05, 0.0, 0.02, 1.1, -0.03, 0.0, 0.1, 0.8), offset=(3.0, -2.0, 1.0)),
)
BOXES = np.array([[0.6, 0.75, 0.06, 0.08, math.cos(0.4), math.sin(0.4), 0.20], [0.95, 0.5, 0.05, 0.05, 1.0, 0.0, 0.20]])


def _reference(
    depth: np.ndarray, color: np.ndarray, calibration: RgbdCalibration, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """`prepare` pixel by pixel in double precision, with OpenCV's lens model; from its description, not its code."""
    lens, other = calibration.depth, calibration.color
    matrix = np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]])
    other_matrix = np.array([[other.fx, 0.0, other.cx], [0.0, other.fy, other.cy], [0.0, 0.0, 1.0]])
    rotation, shift = np.array(calibration.rotation).reshape(3, 3), np.array(calibration.translation)
    v, u = np.nonzero(depth)
    counts = depth[v, u] * calibration.depth_unit
    keep = counts >= calibration.nearest
    v, u, counts = v[keep], u[keep], counts[keep]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    slopes = cv2.undistortPoints(
        np.stack((u, v), axis=-1).astype(np.float64)[:, None], matrix, np.array(lens.distortion), None, None, None, criteria
    )[:, 0]
    points = np.concatenate((slopes, np.ones((len(u), 1))), axis=1) * counts[:, None]
    seen = points @ rotation.T + shift
    places = cv2.projectPoints(seen[:, None], np.zeros(3), np.zeros(3), other_matrix, np.array(other.distortion))[0][:, 0]
    blocks: dict[tuple[int, int], float] = {}
    pixels: list[tuple[int, int] | None] = []
    every = 2 if lens.fx * lens.fy / (width / (2 * math.tan(math.radians(43.0)))) ** 2 >= 8.0 else 1
    for index, (across, down) in enumerate(np.floor(places + 0.5).astype(int)):
        asked = every == 1 or (u[index] + v[index]) % 2 == 0
        inside = asked and 0 <= across < other.width and 0 <= down < other.height
        pixels.append((down, across) if inside else None)
        if inside:
            block = (down // BLOCK, across // BLOCK)
            blocks[block] = min(blocks.get(block, math.inf), seen[index, 2])
    cosine, sine = math.cos(calibration.tilt), math.sin(calibration.tilt)
    focal = width / (2.0 * math.tan(math.radians(43.0)))
    cells: dict[tuple[int, int], list[tuple[float, np.ndarray | None]]] = {}
    for index, (x, y, z) in enumerate(points):
        right, down, ahead = x - calibration.left, cosine * y + sine * z, cosine * z - sine * y + calibration.forward
        cell = (
            math.floor(focal * down / ahead + (height - 1) / 2 + 0.5),
            math.floor(focal * right / ahead + (width - 1) / 2 + 0.5),
        )
        pixel = pixels[index]
        is_seen = pixel is not None and seen[index, 2] <= blocks[pixel[0] // BLOCK, pixel[1] // BLOCK] + HIDDEN
        cells.setdefault(cell, []).append((ahead, color[pixel].astype(float) if pixel is not None and is_seen else None))
    depth_out, color_out = np.zeros((height, width), np.uint16), np.zeros((height, width, 3), np.uint8)
    fewest = max(1, int(0.125 * lens.fx * lens.fy / focal**2))
    for (row, column), samples in cells.items():
        if not (0 <= row < height and 0 <= column < width) or len(samples) < fewest:
            continue
        ordered = sorted(depth for depth, _ in samples)
        low, high = ordered[0], ordered[-1]
        middle = (low + high) / 2 if high - low <= surface_band(low) else ordered[(len(ordered) - 1) // 2]
        band = surface_band(low) if high - low <= surface_band(low) else surface_band(middle)
        members = [sample for sample in samples if abs(sample[0] - middle) <= band]
        depth_out[row, column] = int(1000.0 * np.mean([sample[0] for sample in members]) + 0.5)
        colors = [sample[1] for sample in members if sample[1] is not None]
        if colors:
            value = np.array(calibration.correction.matrix).reshape(3, 3) @ np.mean(colors, axis=0)
            color_out[row, column] = np.clip(value + calibration.correction.offset + 0.5, 0, 255).astype(int)
    return depth_out, color_out


@pytest.mark.parametrize(("width", "height"), [(40, 30), (80, 64)])
def test_agrees_with_the_plain_reference(width: int, height: int) -> None:
    scene = render_rgbd(RgbdCamera(SMALL), BOXES, (0.3, 0.3, 0.9), (0.55, 0.45), 1, seed=3, frame=0, robot_index=0)
    depth, color, _ = prepare(*scene, SMALL, width, height)
    expected_depth, expected_color = _reference(*scene, SMALL, width, height)
    assert np.count_nonzero(expected_depth) > 0.5 * expected_depth.size
    # Single precision may round a sample into the neighbouring pixel; no more than that may differ.
    off = np.abs(depth.astype(int) - expected_depth) > 1
    assert np.mean(off) < 0.01
    assert np.mean(np.any(np.abs(color.astype(int) - expected_color) > 1, axis=2)) < 0.02


def test_the_points_stay_where_they_are() -> None:
    """Every published depth lies on a surface of the scene, as an exact renderer sees it along the same ray."""
    geometry = msgspec.structs.replace(SMALL, depth_unit=0.0001)
    pose = (0.3, 0.3, 0.9)
    depth, _, pinhole = prepare(*render_rgbd(RgbdCamera(geometry, EXACT), BOXES, pose, None, 1, 3, 0, 0), geometry, 40, 30)
    row, column = np.nonzero(depth)
    ahead = 0.001 * depth[row, column]
    right, down = (column - pinhole.cx) / pinhole.fx * ahead, (row - pinhole.cy) / pinhole.fy * ahead
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] + ahead * cosine + right * sine, pose[1] + ahead * sine - right * cosine
    z = pinhole.mount_height - down
    distances = [np.abs(z), np.abs(x), np.abs(1.2 - x), np.abs(y), np.abs(1.2 - y)]
    for box_x, box_y, half_width, half_depth, box_cosine, box_sine, top in BOXES:
        along = np.abs((x - box_x) * box_cosine + (y - box_y) * box_sine) - half_width
        across = np.abs((y - box_y) * box_cosine - (x - box_x) * box_sine) - half_depth
        distances.append(np.abs(np.maximum(np.maximum(along, across), z - top)))
    nearest = np.min(distances, axis=0)
    assert np.median(nearest) < 0.002
    # A published pixel is 2.7 degrees wide here: at edges its mean may lie that far off a surface.
    assert np.percentile(nearest, 97) < 0.012


def test_a_level_camera_with_one_lens_is_only_decimated() -> None:
    lens = lens_of(640, 480, math.radians(86.0))
    calibration = RgbdCalibration(depth=lens, color=lens)
    generator = np.random.default_rng(0)
    blocks = generator.integers(200, 3000, (120, 160)).astype(np.uint16)
    colors = generator.integers(0, 256, (120, 160, 3)).astype(np.uint8)
    depth, color, pinhole = prepare(
        np.kron(blocks, np.ones((4, 4), np.uint16)), np.kron(colors, np.ones((4, 4, 1), np.uint8)), calibration
    )
    assert np.array_equal(depth, blocks)
    # Colours are those of the same pixel, or black where a nearer neighbour may hide it.
    black = ~np.any(color, axis=2)
    assert np.array_equal(color[~black], colors[~black])
    assert pinhole.cx == 79.5 and pinhole.fx == pytest.approx(80.0 / math.tan(math.radians(43.0)))


@given(seed=st.integers(0, 2**32 - 1), near=st.integers(100, 900), gap=st.integers(60, 2000), share=st.floats(0.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_two_surfaces_are_never_mixed(seed: int, near: int, gap: int, share: float) -> None:
    lens = lens_of(160, 120, math.radians(86.0))
    preparer = RgbdPreparer(RgbdCalibration(depth=lens, color=lens), 40, 30)
    is_near = np.random.default_rng(seed).random((120, 160)) < share
    depth = np.where(is_near, near, near + gap).astype(np.uint16)
    out, _, _ = preparer.prepare(depth, np.full((120, 160, 3), 100, np.uint8))
    assert set(np.unique(out)) <= {near, near + gap}
    counts = is_near.reshape(30, 4, 40, 4).sum(axis=(1, 3))
    assert np.array_equal(out == near, counts >= 8)


@given(seed=st.integers(0, 2**32 - 1), holes=st.floats(0.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_anything_a_camera_may_send_is_answered_within_its_bounds(seed: int, holes: float) -> None:
    generator = np.random.default_rng(seed)
    depth = generator.integers(0, 65536, (120, 160)).astype(np.uint16)
    depth[generator.random(depth.shape) < holes] = 0
    color = generator.integers(0, 256, (144, 200, 3)).astype(np.uint8)
    preparer = _SMALL_PREPARER
    out, colors, _ = preparer.prepare(depth, color)
    assert out.shape == (30, 40) and out.dtype == np.uint16
    assert colors.shape == (30, 40, 3) and colors.dtype == np.uint8
    assert not np.any(colors[out == 0])
    if not np.any(depth):
        assert not np.any(out)


_SMALL_PREPARER = RgbdPreparer(SMALL, 40, 30)


def test_what_is_near_does_not_color_what_is_behind_it() -> None:
    calibration = default_rgbd()
    camera = RgbdCamera(calibration, EXACT)
    preparer = RgbdPreparer(calibration)
    for bearing in np.linspace(-0.6, 0.6, 7):
        other = (0.2 + 0.2 * math.cos(bearing), 0.6 + 0.2 * math.sin(bearing))
        depth, color, _ = preparer.prepare(*render_rgbd(camera, NO_BOXES, (0.2, 0.6, 0.0), other, 1, 1, 0, 0))
        red = np.array([is_robot_color(*map(int, pixel), 1) for pixel in color.reshape(-1, 3)]).reshape(depth.shape)
        assert np.count_nonzero(red & (depth < 250)) > 500
        assert np.count_nonzero(red & (depth > 320)) == 0


def test_a_camera_without_returns_sees_nothing() -> None:
    depth, color, _ = _SMALL_PREPARER.prepare(np.zeros((120, 160), np.uint16), np.full((144, 200, 3), 255, np.uint8))
    assert not np.any(depth) and not np.any(color)


def test_single_samples_are_flying_pixels() -> None:
    lens = lens_of(640, 480, math.radians(86.0))
    depth = np.zeros((480, 640), np.uint16)
    depth[100::4, 100::4] = 500
    assert not np.any(prepare(depth, np.zeros((480, 640, 3), np.uint8), RgbdCalibration(depth=lens, color=lens))[0])


def test_the_buffers_are_reused_and_prepare_gives_fresh_ones() -> None:
    scene = render_rgbd(RgbdCamera(SMALL), BOXES, (0.3, 0.3, 0.9), None, 1, 3, 0, 0)
    first = _SMALL_PREPARER.prepare(*scene)
    kept = first[0].copy()
    assert _SMALL_PREPARER.prepare(np.zeros((120, 160), np.uint16), scene[1])[0] is first[0]
    assert not np.any(first[0])
    assert np.array_equal(_SMALL_PREPARER.prepare(*scene)[0], kept)
    assert prepare(*scene, SMALL, 40, 30)[0] is not prepare(*scene, SMALL, 40, 30)[0]


@pytest.mark.parametrize(
    ("depth", "color", "text"),
    [
        (np.zeros((240, 320), np.uint16), np.zeros((144, 200, 3), np.uint8), "depth picture must be uint16 \\[120, 160\\]"),
        (np.zeros((120, 160), np.float32), np.zeros((144, 200, 3), np.uint8), "got float32"),
        (np.zeros((0, 0), np.uint16), np.zeros((144, 200, 3), np.uint8), "calibrated resolution"),
        (np.zeros((120, 160), np.uint16), np.zeros((144, 200), np.uint8), "colour picture must be"),
        (np.zeros((120, 160), np.uint16), np.zeros((144, 200, 4), np.uint8), "colour picture must be"),
        (np.zeros((120, 160), np.uint16), np.zeros((144, 200, 3), np.uint8)[:, ::-1], "C order"),
    ],
)
def test_wrong_pictures_are_refused(depth: np.ndarray, color: np.ndarray, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        _SMALL_PREPARER.prepare(depth, color)


def test_a_calibration_survives_its_file(tmp_path: Path) -> None:
    for calibration in (SMALL, default_rgbd()):
        save_rgbd(calibration, tmp_path / "hider.json")
        assert load_rgbd(tmp_path / "hider.json") == calibration


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"rotation": (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0)}, "is no rotation"),
        ({"rotation": (2.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)}, "is no rotation"),
        ({"rotation": _rotation(0.0, 1.0, 0.0)}, "30 degrees apart"),
        ({"translation": (-15.0, 0.0, 0.0)}, "is a unit wrong"),
        ({"mount_height": 80.0}, "mount_height"),
        ({"tilt": 45.0}, "tilt"),
        ({"depth_unit": 0.0}, "depth_unit"),
        ({"depth": {"width": 640, "height": 480, "fx": 300.0, "fy": 300.0}}, "depth"),
        ({"lens": 1}, "unknown field"),
        ({"color": {**msgspec.to_builtins(lens_of(640, 480, 1.5)), "distortion": (3.0, -9.0, 0.0, 0.0, 5.0)}}, "colour lens"),
    ],
)
def test_unusable_calibrations_are_refused(tmp_path: Path, change: dict[str, object], text: str) -> None:
    path = tmp_path / "hider.json"
    path.write_bytes(msgspec.json.encode({**msgspec.to_builtins(default_rgbd()), **change}))
    with pytest.raises(UnusableRgbdCalibration, match=text) as caught:
        load_rgbd(path)
    assert "hider.json" in str(caught.value) and "\n" not in str(caught.value)


def test_missing_and_broken_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnusableRgbdCalibration, match="calibrate"):
        load_rgbd(tmp_path / "none.json")
    (tmp_path / "half.json").write_text('{"depth": ')
    with pytest.raises(UnusableRgbdCalibration, match=r"half\.json"):
        load_rgbd(tmp_path / "half.json")


def test_more_published_pixels_than_the_camera_has_are_refused() -> None:
    with pytest.raises(UnusableRgbdCalibration, match="finer than"):
        RgbdPreparer(SMALL, 320, 240)


@pytest.mark.parametrize("lens", [SMALL.depth, SMALL.color])
def test_rays_and_projection_are_those_of_opencv(lens: Lens) -> None:
    matrix = np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]])
    slopes = pixel_rays(lens)
    points = np.concatenate((slopes, np.ones((lens.height, lens.width, 1))), axis=-1)
    u, v = np.meshgrid(np.arange(lens.width), np.arange(lens.height))
    projected = cv2.projectPoints(points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), matrix, np.array(lens.distortion))[0]
    assert np.allclose(projected.reshape(lens.height, lens.width, 2), np.stack((u, v), axis=-1), atol=1e-3)
    assert np.allclose(project(lens, 0.7 * points), np.stack((u, v), axis=-1), atol=1e-3)


def test_colors_come_corrected() -> None:
    lens = lens_of(160, 120, math.radians(86.0))
    seen = np.array([200, 80, 60], np.uint8)
    matrix = tuple(np.diag(np.array(SEEKER_COLOR) / seen).ravel().tolist())
    calibration = RgbdCalibration(depth=lens, color=lens, correction=ColorCorrection(matrix=matrix))
    _, color, _ = prepare(np.full((120, 160), 500, np.uint16), np.broadcast_to(seen, (120, 160, 3)).copy(), calibration, 40, 30)
    assert np.all(color == SEEKER_COLOR)


def test_coverage_is_the_share_of_columns_that_a_wall_fills() -> None:
    assert coverage(default_rgbd()) == (1.0, 1.0)
    for changes in ({"color": lens_of(640, 480, math.radians(69.0))}, {"forward": 0.06}, {"tilt": 0.3}, {"left": 0.05}):
        calibration = msgspec.structs.replace(default_rgbd(), **changes)
        # A wall across, 0.6 m ahead of the robot's centre.
        scene = render_rgbd(RgbdCamera(calibration, EXACT), NO_BOXES, (0.6, 0.6, 0.0), None, 1, 1, 0, 0)
        depth, color, pinhole = prepare(*scene, calibration)
        middle = slice(60, 60 + int(0.04 / 0.6 * pinhole.fy) + 1)
        expected = np.mean(np.any(depth[middle] > 0, axis=0)), np.mean(np.any(color[middle] > 0, axis=(0, 2)))
        shares = coverage(calibration)
        assert shares == pytest.approx(expected, abs=0.02)
        assert min(shares) < 1.0


def test_a_file_that_cannot_be_written_anew_stays_what_it_was(tmp_path: Path) -> None:
    path = tmp_path / "hider.json"
    save_rgbd(default_rgbd(), path)
    before = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))  # as a disk that has no room for more
    try:
        with pytest.raises(OSError, match=r"hider\.json"):
            save_rgbd(msgspec.structs.replace(default_rgbd(), tilt=0.1), path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["hider.json"]


@pytest.mark.parametrize("content", [b'{"depth":' * 10_000, b"[" * 100_000, b"\xff\xfe{}", b" " * 1_000_001])
def test_a_file_that_is_none_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "hider.json"
    path.write_bytes(content)
    with pytest.raises(UnusableRgbdCalibration, match=r"hider\.json"):
        load_rgbd(path)
