"""A camera is in the mode that was asked of it, or it is said what it does instead."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import pytest

from vantage.tracking.video_capture import CameraMode, UnusableCamera, open_camera, refusals

MODE = CameraMode(1280, 720, exposure=50.0)


def property_reader(**values: float) -> Callable[[int], float]:
    return {getattr(cv2, f"CAP_PROP_{name}"): value for name, value in values.items()}.__getitem__


def as_asked(mode: CameraMode) -> dict[str, float]:
    return {
        "FRAME_WIDTH": mode.width,
        "FRAME_HEIGHT": mode.height,
        "FPS": mode.rate,
        "FOURCC": float(cv2.VideoWriter.fourcc(*mode.fourcc)),
        "EXPOSURE": mode.exposure or 0.0,
    }


@pytest.mark.parametrize("mode", [CameraMode(1280, 720), CameraMode(640, 480, 60.0, "YUYV", 50.0)])
def test_a_camera_that_does_what_was_asked_is_not_refused(mode: CameraMode) -> None:
    assert refusals(mode, property_reader(**as_asked(mode))) == []


@pytest.mark.parametrize(
    ("read_back", "said"),
    [
        ({"FRAME_WIDTH": 640.0, "FRAME_HEIGHT": 480.0}, "1280 x 720 pixels (it gives 640 x 480)"),
        ({"FPS": 10.0}, "30 frames a second (it gives 10)"),
        ({"FOURCC": float(cv2.VideoWriter.fourcc(*"YUYV"))}, "the format MJPG (it gives YUYV)"),
        ({"FOURCC": -1.0}, "the format MJPG (it does not say which it gives)"),
        ({"FOURCC": 0.0}, "the format MJPG (it does not say which it gives)"),
        ({"EXPOSURE": 300.0}, "an exposure of 50 (it keeps 300)"),
    ],
)
def test_what_a_camera_does_otherwise_is_said(read_back: dict[str, float], said: str) -> None:
    assert refusals(MODE, property_reader(**{**as_asked(MODE), **read_back})) == [said]


@pytest.mark.parametrize("fourcc", ["", "MJPEG"])
def test_what_is_no_format_is_said(fourcc: str) -> None:
    with pytest.raises(UnusableCamera, match=f"`{fourcc}` is no pixel format"):
        open_camera("91", CameraMode(640, 480, fourcc=fourcc))


def test_what_is_not_there_and_what_is_no_camera_are_said(tmp_path: Path) -> None:
    with pytest.raises(UnusableCamera, match="/dev/video91 is not there: plug the camera in; there is"):
        open_camera("91", MODE)
    (tmp_path / "video0").write_bytes(b"no camera")
    with pytest.raises(UnusableCamera, match="video0 does not open: another program has it"):
        open_camera(str(tmp_path / "video0"), MODE)
