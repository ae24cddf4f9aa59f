"""Height and tilt of a robot's camera from the floor it sees; colours from a picture; the file that both write."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as settings_of_tests
from hypothesis import strategies as st

from vantage import table_commands as commands
from vantage.errors import UserError
from vantage.rehearsal.rgbd_picture import RgbdCamera, RgbdLook, render_rgbd
from vantage.setting_up import settings
from vantage.setting_up.coloring import Place, parse_place
from vantage.setting_up.pictures import read_picture, write_picture
from vantage.setting_up.robot_camera import forward_distortion, measure_mount, read_depth, realsense_calibration
from vantage.setting_up.trouble import TableTrouble
from vantage.tracking.rgbd import default_rgbd, load_rgbd, save_rgbd
from vantage.tracking.rgbd_lens import lens_of
from vantage.world.arena import HIDER, SEEKER
from vantage.world.layout import LAB, boxes_array

NOTHING = boxes_array(())


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def camera(tilt: float, height: float) -> RgbdCamera:
    geometry = msgspec.structs.replace(default_rgbd(), tilt=math.radians(tilt), mount_height=height)
    return RgbdCamera(geometry, RgbdLook(red_gain=0.92, blue_gain=1.08))


@pytest.mark.parametrize(("tilt", "height"), [(5.0, 0.080), (0.0, 0.076), (10.0, 0.095), (-2.0, 0.085)])
def test_the_mount_is_measured_from_the_floor(tilt: float, height: float) -> None:
    depth, _ = render_rgbd(camera(tilt, height), NOTHING, (0.15, 0.6, 0.0), None, SEEKER, 1, 3, HIDER)
    mount = measure_mount(depth, default_rgbd())
    assert mount.height == pytest.approx(height, abs=0.001)
    assert math.degrees(mount.tilt) == pytest.approx(tilt, abs=0.4)
    assert abs(math.degrees(mount.roll)) < 0.2


def test_boxes_and_a_robot_farther_away_do_no_harm() -> None:
    depth, _ = render_rgbd(camera(5.0, 0.08), boxes_array(LAB), (0.2, 0.5, 0.3), (0.5, 0.55), SEEKER, 1, 3, HIDER)
    mount = measure_mount(depth, default_rgbd())
    assert mount.height == pytest.approx(0.08, abs=0.001)
    assert math.degrees(mount.tilt) == pytest.approx(5.0, abs=0.5)


def test_roll_is_exactly_that_of_a_rolled_plane() -> None:
    """An ideal floor below a camera that leans by 1 degree; by 3 degrees it is refused."""
    calibration = default_rgbd()
    lens = calibration.depth
    u, v = np.meshgrid(np.arange(lens.width), np.arange(lens.height))
    x, y = (u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy

    def floor(roll: float, tilt: float) -> np.ndarray:
        # Normal of the floor, pointing up, in the camera's axes (x right, y down, z forward).
        normal = np.array([math.sin(roll), -math.cos(roll) * math.cos(tilt), -math.cos(roll) * math.sin(tilt)])
        towards = normal[0] * x + normal[1] * y + normal[2]
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.where(towards < 0.0, -0.08 / towards, 0.0)
        return np.where(z < 4.0, np.round(z / calibration.depth_unit), 0).astype(np.uint16)

    mount = measure_mount(floor(math.radians(1.0), math.radians(6.0)), calibration)
    assert mount.height == pytest.approx(0.08, abs=2e-4)
    assert math.degrees(mount.tilt) == pytest.approx(6.0, abs=0.05)
    assert math.degrees(mount.roll) == pytest.approx(1.0, abs=0.05)
    with pytest.raises(TableTrouble, match=r"leans sideways by 3\.0°: level it"):
        measure_mount(floor(math.radians(3.0), math.radians(6.0)), calibration)


def test_no_floor_is_refused() -> None:
    calibration = default_rgbd()
    with pytest.raises(TableTrouble, match="only 0 points of floor"):
        measure_mount(np.zeros((480, 640), np.uint16), calibration)
    with pytest.raises(TableTrouble, match="is no floor"):
        measure_mount(np.full((480, 640), 400, np.uint16), calibration)
    with pytest.raises(TableTrouble, match="320 x 240 pixels, its lens is for 640 x 480"):
        measure_mount(np.zeros((240, 320), np.uint16), calibration)


def test_recorded_depth_is_read_or_refused() -> None:
    depth = np.arange(12, dtype=np.uint16).reshape(3, 4) * 900
    np.savez("good.npz", depth=depth)
    assert (read_depth(Path("good.npz")) == depth).all()
    np.savez("bad.npz", color=depth)
    write_picture(Path("color.png"), np.zeros((4, 4, 3), np.uint8))
    for name, told in (("bad.npz", "does not hold"), ("color.png", "is no depth picture"), ("none.npz", "there is no depth")):
        with pytest.raises(UserError, match=told):
            read_depth(Path(name))


def test_from_floor_and_colours_to_a_robots_file(capsys: pytest.CaptureFixture[str]) -> None:
    seen = camera(4.0, 0.083)
    depth, _ = render_rgbd(seen, NOTHING, (0.15, 0.6, 0.0), None, SEEKER, 1, 3, HIDER)
    np.savez("floor.npz", depth=depth)
    with pytest.raises(TableTrouble, match="calibrate robot --robot hider"):
        commands.colors(colors_at("both.png", both_robots(seen)))
    wanted = settings.CalibrateRobot(robot="hider", source="floor.npz", forward=0.02)
    assert commands.calibrate_robot(wanted) == 0
    assert commands.colors(colors_at("both.png", both_robots(seen))) == 0
    said = capsys.readouterr().out
    assert "82.9 mm above the floor" in said and "times as bright" in said and "margin hider" in said
    found = load_rgbd(Path("hider.json"))
    assert found.mount_height == pytest.approx(0.083, abs=0.001)
    assert math.degrees(found.tilt) == pytest.approx(4.0, abs=0.4)
    assert found.forward == 0.02
    assert found.correction != default_rgbd().correction
    assert read_picture(Path("hider-colors.png")).shape == (480, 1280, 3)
    # Measured again, the mount changes and the colours stay.
    assert commands.calibrate_robot(settings.CalibrateRobot(robot="hider", source="floor.npz")) == 0
    again = load_rgbd(Path("hider.json"))
    assert (again.forward, again.correction) == (0.0, found.correction)


def both_robots(seen: RgbdCamera) -> np.ndarray:
    """Left half: the hider straight ahead; right half: the seeker; as two cards of their colours would look."""
    halves = [render_rgbd(seen, NOTHING, (0.2, 0.6, 0.0), (0.45, 0.6), color, 1, color, HIDER)[1] for color in (HIDER, SEEKER)]
    middle = robot_columns(halves[0])
    return np.concatenate((halves[0][:, middle - 160 : middle + 160], halves[1][:, middle - 160 : middle + 160]), axis=1)


def robot_columns(picture: np.ndarray) -> int:
    colorful = (picture.max(axis=2).astype(int) - picture.min(axis=2)) > 60
    return int(np.nonzero(colorful)[1].mean())


def colors_at(name: str, shown: np.ndarray, **changed: str) -> settings.Colors:
    write_picture(Path(name), shown)
    colorful = (shown.max(axis=2).astype(int) - shown.min(axis=2)) > 60
    row = int(np.nonzero(colorful)[0].mean())
    places = {"hider": f"160,{row}", "seeker": f"465,{row - 8},30,16", "grey": "20,450,80,25", **changed}
    return settings.Colors(robot="hider", source=name, **places)


def test_colours_alike_are_refused_and_nothing_is_written(capsys: pytest.CaptureFixture[str]) -> None:
    save_rgbd(default_rgbd(), Path("hider.json"))
    before = Path("hider.json").read_bytes()
    shown = both_robots(camera(5.0, 0.08))
    with pytest.raises(TableTrouble, match=r"too alike.*hider-colors\.png"):
        commands.colors(colors_at("both.png", shown, grey="470,230,20,10"))
    assert Path("hider.json").read_bytes() == before


def test_without_pixels_the_picture_is_saved_and_asked_for() -> None:
    write_picture(Path("both.png"), both_robots(camera(5.0, 0.08)))
    with pytest.raises(TableTrouble, match=r"saved as hider-colors\.png.*--seeker, --grey X,Y"):
        commands.colors(settings.Colors(robot="hider", source="both.png", hider="10,10"))
    assert (read_picture(Path("hider-colors.png")) == read_picture(Path("both.png"))).all()


def test_places_are_read_or_refused() -> None:
    assert parse_place("grey", "3,4") == Place(3, 4)
    assert parse_place("grey", "3, 4, 5,6") == Place(3, 4, 5, 6)
    for text in ("3", "a,b", "1,2,3", "-1,4", "1,2,0,4", ""):
        with pytest.raises(TableTrouble, match="--grey"):
            parse_place("grey", text)
    save_rgbd(default_rgbd(), Path("hider.json"))
    with pytest.raises(TableTrouble, match="outside of the picture, which has 640 x 480"):
        commands.colors(colors_at("both.png", both_robots(camera(5.0, 0.08)), grey="600,400,80,20"))


def test_what_a_realsense_says_of_itself_becomes_a_file() -> None:
    """The library's own types, as far as they are read: intrinsics by names, rotation by columns."""
    turn = np.array([[1.0, -0.01, 0.0], [0.01, 1.0, 0.0], [0.0, 0.0, 1.0]])
    lens = SimpleNamespace(
        model="distortion.brown_conrady",
        width=640,
        height=480,
        fx=380.0,
        fy=381.0,
        ppx=320.5,
        ppy=239.5,
        coeffs=[0.05, -0.04, 0.001, -0.002, 0.01],
    )
    stream = SimpleNamespace(
        get_intrinsics=lambda: lens,
        get_extrinsics_to=lambda _: SimpleNamespace(rotation=turn.T.ravel().tolist(), translation=[0.015, 0.0, 0.001]),
    )
    device = SimpleNamespace(first_depth_sensor=lambda: SimpleNamespace(get_depth_scale=lambda: 0.001), get_info=lambda _: "0123")
    profile = SimpleNamespace(
        get_stream=lambda _: SimpleNamespace(as_video_stream_profile=lambda: stream), get_device=lambda: device
    )
    library = SimpleNamespace(stream=SimpleNamespace(depth=1, color=2), camera_info=SimpleNamespace(serial_number=1))
    found = realsense_calibration(library, profile)
    assert np.array(found.rotation).reshape(3, 3) == pytest.approx(turn)
    assert found.translation == (0.015, 0.0, 0.001)
    assert (found.color.cx, found.depth.distortion) == (320.5, (0.05, -0.04, 0.001, -0.002, 0.01))
    save_rgbd(found, Path("real.json"))
    assert load_rgbd(Path("real.json")) == found


REAL = np.array([-0.055, 0.064, -0.0001, 0.0006, -0.02])
"""Distortion of the size and signs that RealSense colour cameras have."""


@settings_of_tests(max_examples=20, deadline=None)
@given(st.floats(-1.2, 1.5), st.floats(-0.0015, 0.0015), st.floats(-0.0015, 0.0015))
def test_a_distortion_given_for_the_way_back_is_turned_round(scale: float, first: float, second: float) -> None:
    """Pixel to ray as librealsense does it, ray to pixel as OpenCV does: the same pixel."""
    lens = lens_of(640, 480, math.radians(87.0))
    inverse = scale * REAL + np.array([0.0, 0.0, first, second, 0.0])
    forward = forward_distortion(inverse, lens)
    k1, k2, p1, p2, k3 = inverse
    matrix = np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]])
    for u, v in ((0, 0), (639, 0), (300, 240), (20, 460), (639, 479), (500, 100)):
        x, y = (u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy
        square = x * x + y * y
        factor = 1 + k1 * square + k2 * square**2 + k3 * square**3
        across = x * factor + 2 * p1 * x * y + p2 * (square + 2 * x * x)
        down = y * factor + 2 * p2 * x * y + p1 * (square + 2 * y * y)
        pixel = cv2.projectPoints(np.array([(across, down, 1.0)]), np.zeros(3), np.zeros(3), matrix, forward)[0].ravel()
        assert pixel == pytest.approx([u, v], abs=0.2)


def test_a_distortion_that_cannot_be_turned_round_is_refused() -> None:
    with pytest.raises(TableTrouble, match=r"cannot be turned round to 0\.5 px"):
        forward_distortion(np.array([0.06, 0.07, 0.0, 0.0, 0.02]), lens_of(640, 480, math.radians(87.0)))


def test_without_the_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(TableTrouble, match="pip install"):
        commands.calibrate_robot(settings.CalibrateRobot(robot="seeker"))
