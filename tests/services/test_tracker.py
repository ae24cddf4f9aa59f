"""The tracker's parts: what counts as a step's frame, what is said to be missing, which calibration is refused."""

from __future__ import annotations

import datetime
import os
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas import ROBOTS, Box, DepthImage, Intrinsics, Pose
from services.tracker.calibrated import CalibrationFiles, CalibrationSettings
from services.tracker.capture import Picture, StepCapture
from services.tracker.table_layout import MOVED, have_moved
from services.tracker.watch import CameraWatch
from vantage.rehearsal.overhead_picture import rehearsal_camera
from vantage.service import SECOND, CannotStart, DeviceLost, Publish
from vantage.tracking.calibration import save_calibration
from vantage.tracking.overhead import TrackState
from vantage.tracking.rgbd import default_rgbd, save_rgbd
from vantage.tracking.table import default_table, save_table

LENS = Intrinsics(fx=4.0, fy=4.0, cx=1.5, cy=1.0)


def track(stamp: int, seen: bool = True, heading: float = 0.0) -> TrackState:
    return TrackState(0.5, 0.6, heading, 0.0, 0.0, 0.0, (0.0,) * 6, seen, stamp)


def picture(stamp: int) -> Picture:
    return Picture(stamp, np.full((3, 4), stamp % 65535, np.uint16), np.zeros((3, 4, 3), np.uint8), LENS)


@given(
    st.lists(st.tuples(st.sampled_from(["above", *ROBOTS]), st.integers(1, 20), st.booleans()), max_size=40),
    st.integers(1, 20),
)
def test_a_step_is_made_of_the_first_frames_after_its_motions(frames: list[tuple[str, int, bool]], after: int) -> None:
    """Against the plain rule, applied to all frames at once."""
    capture = StepCapture(3, 7, after)
    for camera, stamp, seen in frames:
        if camera == "above":
            capture.see(dict.fromkeys(ROBOTS, track(stamp, seen)), stamp)
        elif capture.wants(camera, stamp):
            capture.look(camera, picture(stamp))
    first = {
        camera: next((s for c, s, seen in frames if c == camera and s > after and (seen or camera != "above")), None)
        for camera in ("above", *ROBOTS)
    }
    assert capture.complete == all(stamp is not None for stamp in first.values())
    if capture.complete:
        messages = [send.message for send in capture.messages() if isinstance(send, Publish)]
        assert [type(message) for message in messages[-2:]] == [Pose, Pose]
        assert {message.stamp for message in messages[-2:]} == {first["above"]}
        assert [message.stamp for message in messages if isinstance(message, DepthImage)] == [first[robot] for robot in ROBOTS]
        assert all((message.episode, message.step) == (3, 7) for message in messages)


def test_a_heading_beyond_half_a_turn_is_wrapped() -> None:
    capture = StepCapture(1, 0, 0)
    capture.see(dict.fromkeys(ROBOTS, track(1, heading=6.0)), 1)
    for robot in ROBOTS:
        capture.look(robot, picture(1))
    poses = [send.message for send in capture.messages() if isinstance(send, Publish) and send.key.endswith("pose")]
    assert all(isinstance(pose, Pose) and pose.heading == pytest.approx(6.0 - 2 * np.pi) for pose in poses)


def test_what_is_missing_is_named_with_its_age_and_forgotten_when_it_is_back() -> None:
    watch = CameraWatch(("hider camera", "overhead camera"), "no frame")
    assert watch.troubles(0, 1.0) == []
    watch.there("overhead camera", SECOND)
    assert watch.troubles(2 * SECOND, 1.0) == ["hider camera: no frame yet"]
    watch.there("hider camera", 2 * SECOND)
    assert watch.troubles(33 * SECOND // 10, 1.0) == [
        "hider camera: no frame for 1.3 s",
        "overhead camera: no frame for 2.3 s",
    ]
    watch.lost("overhead camera", "overhead camera: pulled")
    watch.there("hider camera", 33 * SECOND // 10)
    assert watch.troubles(33 * SECOND // 10, 1.0) == ["overhead camera: pulled"]
    assert not watch.is_fresh("overhead camera", 33 * SECOND // 10, 10.0)
    watch.there("overhead camera", 34 * SECOND // 10)
    assert watch.troubles(34 * SECOND // 10, 1.0) == []


def test_boxes_move_beyond_noise_come_and_go() -> None:
    boxes = (Box(x=0.3, y=0.3, half_width=0.1, half_depth=0.05), Box(x=0.8, y=0.7, half_width=0.1, half_depth=0.05))

    def moved(**change: float) -> tuple[Box, ...]:
        return (msgspec.structs.replace(boxes[0], **change), boxes[1])

    assert not have_moved(boxes, boxes)
    assert not have_moved(boxes, boxes[::-1])
    assert not have_moved(boxes, moved(x=0.3 + 0.9 * MOVED))
    assert have_moved(boxes, moved(x=0.3 + 1.1 * MOVED))
    assert have_moved(boxes, moved(heading=0.1))
    assert have_moved(boxes, boxes[:1])
    assert have_moved((), boxes[:1])


@pytest.fixture
def settings(tmp_path: Path) -> CalibrationSettings:
    """Where a calibration of today is."""
    save_table(default_table(), tmp_path / "table.json")
    save_calibration(rehearsal_camera(date=datetime.date.today()), tmp_path / "overhead.json")
    for robot in ROBOTS:
        save_rgbd(default_rgbd(), tmp_path / f"{robot}.json")
    names = ("table", "overhead", *ROBOTS)
    table, overhead, hider, seeker = (tmp_path / f"{name}.json" for name in names)
    return CalibrationSettings(table, overhead, hider, seeker)


def test_a_good_calibration_is_read(settings: CalibrationSettings) -> None:
    calibrated = CalibrationFiles(settings, 1280, 720).load_at_start()
    assert calibrated.table == default_table()
    assert set(calibrated.robots) == set(ROBOTS)


@pytest.mark.parametrize("name", ["table", "overhead", *ROBOTS])
@pytest.mark.parametrize("content", [None, b"", b"{}", b'{"width": 3}', b"\xff"])
def test_a_missing_or_broken_file_is_refused_in_one_line_that_names_it(
    settings: CalibrationSettings, tmp_path: Path, name: str, content: bytes | None
) -> None:
    path = tmp_path / f"{name}.json"
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(CannotStart) as refused:
        CalibrationFiles(settings, 1280, 720).load_at_start()
    assert str(path) in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


def test_another_resolution_and_an_old_calibration_are_refused(settings: CalibrationSettings) -> None:
    with pytest.raises(CannotStart, match="640"):
        CalibrationFiles(settings, 640, 480).load_at_start()
    old = datetime.date.today() - datetime.timedelta(days=100)
    save_calibration(rehearsal_camera(date=old), settings.calibration)
    with pytest.raises(CannotStart, match="days"):
        CalibrationFiles(settings, 1280, 720).load_at_start()
    assert CalibrationFiles(replace(settings, oldest_days=101), 1280, 720).load_at_start()


def test_a_calibration_made_meanwhile_is_taken_up_and_a_bad_one_is_not(settings: CalibrationSettings) -> None:
    files = CalibrationFiles(settings, 1280, 720)
    first = files.load_at_start()
    assert files.read() is None
    save_table(msgspec.structs.replace(first.table, corner_size=0.07), settings.table)
    os.utime(settings.table, ns=(1, 1))
    assert files.read() is None  # it may still be being written
    changed = files.read()
    assert changed is not None and changed[0].table.corner_size == 0.07
    settings.table.write_bytes(b"{")
    files.read()
    with pytest.raises(DeviceLost, match="the former calibration stays in force"):
        files.read()
