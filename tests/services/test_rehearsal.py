"""The rehearsed table: robots move by the clock, cameras look when due and never pile up, plugs can be pulled."""

from __future__ import annotations

import math
import os
from pathlib import Path

import msgspec
import numpy as np
import pytest

from schemas import ROBOTS, ColorImage, DepthImage, Intrinsics
from services.rehearsal.cameras import Cameras
from services.rehearsal.core import CAMERAS, CameraSettings, Exposure, RehearsalCore
from services.rehearsal.devices import Faults, Line, Truth
from services.rehearsal.preparation import Prepared, TableSettings, calibrate_rgbd, prepare_table
from services.rehearsal.world import World
from vantage.drive.protocol import SetSpeeds, encode
from vantage.rehearsal.overhead_picture import rehearsal_camera
from vantage.service import SECOND, Captured, DeviceLost, Publish, Woken, Write
from vantage.world.layout import ImpossibleLayout, boxes_array
from vantage.world.motion import is_free

MILLISECOND = SECOND // 1000
START = 1000 * SECOND


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare_table(TableSettings())


def make(prepared: Prepared, **settings: float) -> RehearsalCore:
    world = World(prepared.obstacles, prepared.starts, seed=3)
    return RehearsalCore(world, CameraSettings(**settings))  # type: ignore[arg-type]


def run(
    core: RehearsalCore,
    start: int,
    seconds: float,
    cameras: Cameras | None = None,
    drawing: int = 0,
    period: int = 10 * MILLISECOND,
) -> list[Publish | Write]:
    """Let the table's time pass; each frame takes `drawing` ns, and is blank without cameras."""
    sends: list[Publish | Write] = []
    drawn: list[tuple[int, Captured]] = []
    for now in range(start, start + int(seconds * SECOND), period):
        events = [captured for due, captured in drawn if due <= now]
        drawn = [(due, captured) for due, captured in drawn if due > now]
        for event in (*events, Woken()):
            for send in core.step(event, now):
                if isinstance(send, Write) and send.device == CAMERAS:
                    frames = blank(send.data) if cameras is None else cameras.draw(send.data)
                    drawn.append((now + drawing, Captured(CAMERAS, frames, now)))
                sends.append(send)  # type: ignore[arg-type]
    return sends


def blank(data: bytes) -> list[tuple[str, ColorImage | DepthImage]]:
    """Frames of one pixel."""
    exposure = msgspec.msgpack.decode(data, type=Exposure)
    size = {"stamp": exposure.stamp, "width": 1, "height": 1, "intrinsics": Intrinsics(fx=1.0, fy=1.0, cx=0.5, cy=0.5)}
    color, depth = ColorImage(**size, data=bytes(3)), DepthImage(**size, data=bytes(2))
    if exposure.camera == "overhead camera":
        return [("overhead/color", color)]
    robot = exposure.camera.partition(" ")[0]
    return [(f"{robot}/camera/depth", depth), (f"{robot}/camera/color", color)]


def frames(sends: list[Publish | Write]) -> dict[str, list[ColorImage | DepthImage]]:
    found: dict[str, list[ColorImage | DepthImage]] = {}
    for send in sends:
        if isinstance(send, Publish):
            assert isinstance(send.message, ColorImage | DepthImage)
            found.setdefault(send.key, []).append(send.message)
    return found


def test_frames_come_at_their_rates_in_pairs_of_one_stamp(prepared: Prepared) -> None:
    cameras = Cameras(prepared.obstacles, prepared.scene, prepared.cameras, seed=1)
    seen = frames(run(make(prepared, overhead_rate=10.0, camera_rate=5.0), START, 2.0, cameras))
    assert len(seen["overhead/color"]) in (19, 20)
    for robot in ROBOTS:
        depth, color = seen[f"{robot}/camera/depth"], seen[f"{robot}/camera/color"]
        assert len(depth) in (9, 10)
        assert [frame.stamp for frame in depth] == [frame.stamp for frame in color]
        assert (depth[0].width, depth[0].height) == (color[0].width, color[0].height) == (640, 480)
    assert (seen["overhead/color"][0].width, seen["overhead/color"][0].height) == (1280, 720)


def test_where_drawing_is_slow_lines_are_answered_and_every_second_picture_is_from_above(prepared: Prepared) -> None:
    """A busy machine: a frame takes 150 ms. Robots that did not answer meanwhile were taken for switched off."""
    core = make(prepared)
    core.step(Captured("hider line", encode(SetSpeeds(1, 0, 0)), START), START)
    sends = run(core, START, 6.0, drawing=150 * MILLISECOND)
    seen = frames(sends)
    assert len(seen["overhead/color"]) >= 0.45 * len([send for send in sends if isinstance(send, Publish)]) * 2 / 3
    gaps = np.diff([frame.stamp for frame in seen["overhead/color"]])
    assert gaps.max() <= 320 * MILLISECOND
    assert {f"{robot}/camera/depth" for robot in ROBOTS} < set(seen)
    lines = [send for send in sends if isinstance(send, Write) and send.device == "hider line"]
    assert len(lines) > 0.9 * 50 * 6  # telemetry, 50 times a second
    assert core.trouble.startswith("this machine is too slow: it draws 3.")
    assert "of 20 pictures a second from above" in core.trouble
    core.step(Captured(CAMERAS, [], START + 6 * SECOND), START + 6 * SECOND)  # the last one is done
    run(core, START + 6 * SECOND, 6.0)
    assert core.trouble == ""


def test_a_world_held_up_leaves_frames_out_and_does_not_fall_behind(prepared: Prepared) -> None:
    core = make(prepared)
    run(core, START, 0.5)
    sends = run(core, START + 3 * SECOND, 0.5)  # nobody woke it for 2.5 s
    seen = frames(sends)
    assert len(seen["overhead/color"]) <= 11
    assert all(START + 3 * SECOND <= frame.stamp <= START + 3.5 * SECOND for frame in seen["overhead/color"])


def test_a_world_that_was_held_up_loses_no_telemetry_and_one_that_slept_goes_on_from_now(prepared: Prepared) -> None:
    world = World(prepared.obstacles, prepared.starts, seed=3)
    world.advance(START)
    assert world.advance(START + SECOND * 9 // 10)["hider"].count(b"$T") >= 42  # of 45, one in a hundred is lost
    said = world.advance(START + 3600 * SECOND)
    assert said.get("hider", b"").count(b"$T") <= 2
    later = world.advance(START + 3600 * SECOND + SECOND // 2)
    times = [int(line.split(b",")[2]) for line in later["hider"].splitlines() if line.startswith(b"$T")]
    assert 20 <= len(times) <= 26 and times[-1] < 2000  # ms by the robot's own clock


def test_what_is_unplugged_gives_nothing_until_it_is_plugged_in_again(prepared: Prepared) -> None:
    core = make(prepared)
    core.step(Captured("faults", frozenset({"hider camera", "overhead camera", "seeker line"}), START), START)
    assert core.trouble == "unplugged: hider camera, overhead camera, seeker line"
    sends = run(core, START, 1.0)
    assert set(frames(sends)) == {"seeker/camera/depth", "seeker/camera/color"}
    assert {send.device for send in sends if isinstance(send, Write)} == {"hider line", CAMERAS}
    core.step(Captured("faults", frozenset(), START + SECOND), START + SECOND)
    assert core.trouble == ""
    assert len(frames(run(core, START + SECOND, 1.0))) == 5


def test_a_robot_drives_as_its_line_says_and_stops_when_the_line_is_silent(prepared: Prepared) -> None:
    world = World((), ((0.3, 0.6, 0.0), (0.9, 0.6, math.pi)), seed=1)
    core = RehearsalCore(world, CameraSettings(overhead_rate=1.0, camera_rate=1.0))
    run(core, START, 0.1)
    now = START + 100 * MILLISECOND
    for number in range(10):
        core.step(Captured("hider line", encode(SetSpeeds(number, 100, 100)), now), now)
        run(core, now, 0.05)
        now += 50 * MILLISECOND
    moved = world.poses()[0, 0] - 0.3
    assert 0.035 < moved < 0.055  # half a second at 0.1 m/s, less lag
    run(core, now, 1.0)
    stopped = world.poses()[0, 0]
    assert stopped - 0.3 - moved < 0.1 * 0.45  # the watchdog's 0.3 s and the wheels' lag
    run(core, now + SECOND, 0.5)
    assert world.poses()[0, 0] == pytest.approx(stopped, abs=1e-6)
    assert world.poses()[1].tolist() == [0.9, 0.6, math.pi]


def test_the_robots_first_stand_where_they_fit(prepared: Prepared) -> None:
    for x, y, _ in prepared.starts:
        assert is_free(boxes_array(prepared.obstacles), 1.2, 1.2, x, y, 0.065)
    assert len(prepared.table.obstacles) == len(prepared.obstacles)


def test_an_impossible_table_is_refused() -> None:
    with pytest.raises(ImpossibleLayout, match="nowhere"):
        prepare_table(TableSettings(layout="/nowhere.json"))


def test_the_trackers_calibration_is_measured_not_told(prepared: Prepared) -> None:
    for index, robot in enumerate(ROBOTS):
        camera = prepared.cameras[robot]
        found = calibrate_rgbd(camera, 1, index)
        assert found.mount_height != camera.geometry.mount_height
        assert abs(found.mount_height - camera.geometry.mount_height) <= 0.0005
        assert found.tilt != camera.geometry.tilt
        assert found.correction.matrix != camera.geometry.correction.matrix
    assert rehearsal_camera().made_with == "rehearsal"


def test_faults_are_read_from_a_file_that_people_write(tmp_path: Path) -> None:
    faults = Faults(tmp_path / "unplugged")
    assert faults.read() == (frozenset(), pytest.approx(0, abs=2**63))
    assert faults.read() is None
    (tmp_path / "unplugged").write_text("hider camera\nno such thing\n seeker line \n")
    changed = faults.read()
    assert changed is not None and changed[0] == {"hider camera", "seeker line"}
    (tmp_path / "unplugged").unlink()
    changed = faults.read()
    assert changed is not None and changed[0] == frozenset()


def test_a_line_is_a_terminal_that_can_be_unplugged(tmp_path: Path) -> None:
    faults = Faults(tmp_path / "unplugged")
    line = Line("hider line", tmp_path / "hider.tty", faults)
    line.write(b"nobody hears this")
    line.open()
    try:
        driver = os.open(tmp_path / "hider.tty", os.O_RDWR | os.O_NOCTTY)
        try:
            os.write(driver, b"$Q,1*0000\n")
            got = line.read()
            assert got is not None and got[0] == b"$Q,1*0000\n"
            line.write(b"$A,1,0*0000\n")
            assert os.read(driver, 64) == b"$A,1,0*0000\n"
            (tmp_path / "unplugged").write_text("hider line\n")
            with pytest.raises(DeviceLost, match="unplugged"):
                line.read()
        finally:
            os.close(driver)
    finally:
        line.close()
    assert not (tmp_path / "hider.tty").exists()
    with pytest.raises(DeviceLost, match="unplugged"):
        line.open()
    (tmp_path / "unplugged").unlink()
    line.open()
    assert (tmp_path / "hider.tty").exists()
    line.close()
    line.close()


def test_the_truth_is_written_for_studies(prepared: Prepared, tmp_path: Path) -> None:
    truth = Truth(tmp_path / "truth.csv")
    truth.open()
    world = World(prepared.obstacles, prepared.starts, seed=3)
    settings = CameraSettings(overhead_rate=1.0, camera_rate=1.0, truth=True)
    core = RehearsalCore(world, settings)
    for send in run(core, START, 1.0):
        if isinstance(send, Write) and send.device == "truth":
            truth.write(send.data)
    truth.close()
    rows = np.loadtxt(tmp_path / "truth.csv", delimiter=",", skiprows=1)
    assert rows.shape == (20, 7)
    np.testing.assert_allclose(rows[-1, 1:], np.array(prepared.starts).ravel(), atol=1e-6)
