"""The tracker's cameras: what they do otherwise than asked is said; files are paced, and their end is said."""

from __future__ import annotations

import resource
import sys
import time
import zipfile
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import cv2
import numpy as np
import pytest
from PIL import Image

from schemas import ColorImage, DepthImage, Intrinsics, Message
from services.tracker.devices import DrivenCamera, OverheadSettings, PictureFolder, VideoFile
from services.tracker.realsense import LATENCY, RealSense
from services.tracker.recordings import FrameFolder, LoggedFrames
from services.tracker.sources import overhead_device, rgbd_device
from tests.log.making import records_of, write_log
from vantage.service import SECOND, Device, DeviceLost, steady_clock

SHADES = (40, 120, 200)


def frames_of(device: Device, limit: float = 120.0) -> tuple[list[Any], list[float], str]:
    """Read a device until it is lost: values, seconds at which they came, and the reason."""
    values, times = [], []
    started = time.monotonic()
    device.open()
    try:
        while time.monotonic() - started < limit:
            got = device.read()
            if got is not None:
                values.append(got[0])
                times.append(time.monotonic() - started)
    except DeviceLost as lost:
        return values, times, str(lost)
    finally:
        device.close()
    raise AssertionError("the device did not end")


def test_a_camera_that_is_not_there_is_said_with_what_to_do() -> None:
    camera = DrivenCamera("overhead camera", "/dev/video97", OverheadSettings())
    with pytest.raises(DeviceLost, match="overhead camera: /dev/video97 is not there: plug the camera in"):
        camera.open()
    camera.close()


def test_what_is_no_camera_is_refused(tmp_path: Path) -> None:
    (tmp_path / "video0").write_bytes(b"no camera")
    camera = DrivenCamera("overhead camera", str(tmp_path / "video0"), OverheadSettings())
    with pytest.raises(DeviceLost, match="does not open"):
        camera.open()
    camera.close()


def test_a_video_file_gives_its_frames_in_rgb_and_says_when_it_has_ended(tmp_path: Path) -> None:
    path = tmp_path / "table.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (64, 48))
    for shade in SHADES:
        writer.write(np.full((48, 64, 3), (0, 0, shade), np.uint8))  # red, in OpenCV's order
    writer.release()
    video = overhead_device("overhead camera", str(path), OverheadSettings())
    assert isinstance(video, VideoFile)
    values, times, said = frames_of(video)
    assert [round(float(value[..., 0].mean()), -1) for value in values] == list(SHADES)
    assert all(value.shape == (48, 64, 3) and value[..., 2].mean() < 30 for value in values)
    assert times[-1] >= 2 / 20.0  # at its own pace, 20 a second
    assert said == f"overhead camera: {path} has ended"
    with pytest.raises(DeviceLost, match="has ended"):
        video.open()


def write_uneven_video(path: Path, times: list[int]) -> None:
    """Write a video whose frames come at these times, ms."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=1000)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
        for shade, at in enumerate(times):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 20 + 30 * shade, np.uint8), format="rgb24")
            frame.pts, frame.time_base = at, Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_frames_of_a_video_of_variable_rate_keep_their_times(tmp_path: Path, suffix: str) -> None:
    times = [0, 40, 80, 380, 400, 900]
    write_uneven_video(tmp_path / f"table{suffix}", times)
    video = VideoFile("overhead camera", tmp_path / f"table{suffix}")
    video.open()
    stamps: list[int] = []
    while len(stamps) < len(times):
        got = video.read()
        if got is not None:
            assert got[1] <= steady_clock()
            stamps.append(got[1])
    video.close()
    after = [round((stamp - stamps[0]) / 1e6) for stamp in stamps]
    if max(after) < 1000:  # else this machine did not keep the pace, and the video went on later
        assert after == pytest.approx(times, abs=2)


def test_turned_pictures_are_read_as_the_sensor_took_them(tmp_path: Path) -> None:
    turned = Image.fromarray(np.full((40, 60, 3), 90, np.uint8))
    exif = turned.getexif()
    exif[0x0112] = 6
    turned.save(tmp_path / "0.jpg", exif=exif)
    turned.save(tmp_path / "0.color.png", exif=exif)
    cv2.imwrite(str(tmp_path / "0.depth.png"), np.full((40, 60), 500, np.uint16))
    (tmp_path / "only").mkdir()
    (tmp_path / "0.jpg").rename(tmp_path / "only" / "0.jpg")
    ((picture,), _, _) = frames_of(PictureFolder("overhead camera", tmp_path / "only", 0.0))
    assert picture.shape == (40, 60, 3)
    (((_, color),), _, _) = frames_of(FrameFolder("hider camera", tmp_path, 0.0))
    assert color.shape == (40, 60, 3)


def npy_header(shape: tuple[int, ...], kind: str = "<u2") -> bytes:
    text = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode()
    text += b" " * (118 - len(text)) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


TAMPERED = {
    "larger than memory": npy_header((10**9, 10**9)),
    "larger than a picture": npy_header((20_000, 20_000)) + bytes(1000),
    "shorter than it says": npy_header((480, 640)) + bytes(1000),
    "pickled": npy_header((1,), "|O") + b"cos\nsystem\n(S'touch pickled'\ntR.",
    "no header": b"\x93NUMPY\x01\x00\xff\xff",
    "of a format to come": b"\x93NUMPY\x09\x00" + bytes(200),
    "nothing": b"",
}


@pytest.mark.parametrize("content", TAMPERED.values(), ids=TAMPERED)
def test_tampered_arrays_are_refused_before_they_are_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: bytes
) -> None:
    monkeypatch.chdir(tmp_path)
    with zipfile.ZipFile(tmp_path / "0.npz", "w") as archive:
        archive.writestr("depth.npy", content)
        archive.writestr("color.npy", npy_header((480, 640, 3), "|u1") + bytes(480 * 640 * 3))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert "0.npz does not hold the arrays depth and color" in frames_of(FrameFolder("hider camera", tmp_path, 0.0))[2]
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # KB
    assert not (tmp_path / "pickled").exists()


def test_a_bomb_of_zeros_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "0.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("depth.npy", npy_header((20_000, 5_000)) + bytes(2 * 20_000 * 5_000))
    assert "depth is 20000 x 5000, larger than any picture" in frames_of(FrameFolder("hider camera", tmp_path, 0.0))[2]


def test_a_folder_of_pictures_is_read_in_order(tmp_path: Path) -> None:
    for number, shade in enumerate(SHADES):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.full((4, 6, 3), (shade, 0, 0), np.uint8))
    values, _, _ = frames_of(PictureFolder("overhead camera", tmp_path, 0.0))
    assert [int(value[0, 0, 2]) for value in values] == list(SHADES)


@pytest.mark.parametrize("make", [lambda path: PictureFolder("camera", path, 0.0), lambda path: FrameFolder("camera", path, 0.0)])
def test_an_empty_folder_and_a_missing_one_are_said(make: Callable[[Path], Device], tmp_path: Path) -> None:
    assert "holds " in frames_of(make(tmp_path))[2]
    with pytest.raises(DeviceLost, match="there is no"):
        make(tmp_path / "nowhere").open()


def pair(shade: int) -> tuple[Any, Any]:
    color = np.zeros((4, 6, 3), np.uint8)
    color[..., 0] = shade
    return np.full((4, 6), 5 * shade, np.uint16), color


def test_recorded_pairs_are_read_as_arrays_and_as_pictures(tmp_path: Path) -> None:
    arrays, pictures = tmp_path / "arrays", tmp_path / "pictures"
    arrays.mkdir()
    pictures.mkdir()
    for number, shade in enumerate(SHADES):
        depth, color = pair(shade)
        np.savez(arrays / f"{number}.npz", depth=depth, color=color)
        cv2.imwrite(str(pictures / f"{number}.depth.png"), depth)
        cv2.imwrite(str(pictures / f"{number}.color.png"), color[..., ::-1])
    for folder in (arrays, pictures):
        values, _, said = frames_of(FrameFolder("hider camera", folder, 0.0))
        assert said.endswith("has ended")
        for (depth, color), shade in zip(values, SHADES, strict=True):
            np.testing.assert_array_equal(depth, pair(shade)[0])
            np.testing.assert_array_equal(color, pair(shade)[1])


@pytest.mark.parametrize("content", [b"", b"no archive"])
def test_a_broken_recording_is_said(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "0.npz").write_bytes(content)
    assert "0.npz does not hold the arrays" in frames_of(FrameFolder("hider camera", tmp_path, 0.0))[2]


def test_arrays_of_another_type_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "0.npz", depth=np.zeros((4, 6)), color=np.zeros((4, 6, 3), np.uint8))
    assert "must hold depth uint16" in frames_of(FrameFolder("hider camera", tmp_path, 0.0))[2]


def test_a_robots_pictures_are_read_from_a_log(tmp_path: Path) -> None:
    messages: list[tuple[str, Message]] = []
    intrinsics = Intrinsics(fx=5.0, fy=5.0, cx=2.5, cy=1.5)
    for step, shade in enumerate(SHADES):
        depth, color = pair(shade)
        shape: dict[str, Any] = {"stamp": 10 + step, "step": step, "width": 6, "height": 4, "intrinsics": intrinsics}
        messages.append(("hider/depth", DepthImage(**shape, data=depth.tobytes())))
        messages.append(("hider/color", ColorImage(**shape, data=color.tobytes())))
    log = tmp_path / "game.mcap"
    write_log(log, records_of(messages))
    values, _, said = frames_of(LoggedFrames("hider camera", log, 0.0, "hider"))
    assert [int(color[0, 0, 0]) for _, color in values] == list(SHADES)
    assert said.endswith("has ended")
    assert "no depth and colour pictures of the seeker" in frames_of(LoggedFrames("camera", log, 0.0, "seeker"))[2]


def test_a_realsense_without_its_package_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(DeviceLost, match=r'hider camera: pyrealsense2 is not installed: .* --editable "\.\[tracker,realsense\]"'):
        RealSense("hider camera", "123").open()


class Camera:
    """What stands in for pyrealsense2 where no camera is: one camera, its pipeline, and its frames."""

    def __init__(self, stamp_ms: Callable[[], float], domain: str) -> None:
        self.stamp_ms, self.domain, self.pulled = stamp_ms, domain, False
        self.stream = SimpleNamespace(depth=1, color=2)
        self.format = SimpleNamespace(z16=1, rgb8=2)
        self.camera_info = SimpleNamespace(serial_number=0)
        self.timestamp_domain = SimpleNamespace(hardware_clock="hardware", system_time="system", global_time="global")

    def context(self) -> Any:
        return SimpleNamespace(query_devices=lambda: [SimpleNamespace(get_info=lambda _: "123")])

    def config(self) -> Any:
        return SimpleNamespace(enable_device=lambda serial: None, enable_stream=lambda *what: None)

    def pipeline(self) -> Any:
        return SimpleNamespace(start=lambda configuration: "profile", stop=self._stop, try_wait_for_frames=self._wait)

    def _stop(self) -> None:
        if self.pulled:
            raise RuntimeError("stop() cannot be called before start()")

    def _wait(self, milliseconds: int) -> tuple[bool, Any]:
        def frame(shape: tuple[int, ...], kind: type) -> Any:
            return SimpleNamespace(
                get_data=lambda: np.zeros(shape, kind),
                get_timestamp=self.stamp_ms,
                get_frame_timestamp_domain=lambda: self.domain,
            )

        depth, color = frame((4, 6), np.uint16), frame((4, 6, 3), np.uint8)
        return True, SimpleNamespace(get_depth_frame=lambda: depth, get_color_frame=lambda: color)


@pytest.mark.parametrize(
    ("domain", "age", "counted"),
    [
        ("global", 0.12, 0.12),
        ("system", 0.3, 0.3),
        ("hardware", 0.12, LATENCY),
        ("global", 3600.0, LATENCY),
        ("global", -5.0, LATENCY),
    ],
)
def test_a_realsense_stamps_its_frames_if_its_clock_is_ours(
    monkeypatch: pytest.MonkeyPatch, domain: str, age: float, counted: float
) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", Camera(lambda: 1000.0 * (time.time() - age), domain))
    device = RealSense("hider camera", "")
    device.open()
    before = steady_clock()
    got = device.read()
    after = steady_clock()
    assert got is not None
    assert before - 0.01 * SECOND <= got[1] + counted * SECOND <= after + 0.01 * SECOND
    device.close()


def test_a_realsense_that_was_pulled_out_closes_and_opens_again(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = Camera(lambda: 0.0, "hardware")
    monkeypatch.setitem(sys.modules, "pyrealsense2", camera)
    device = RealSense("hider camera", "123")
    device.open()
    camera.pulled = True
    device.close()
    device.close()
    camera.pulled = False
    device.open()
    assert device.read() is not None


def test_a_sources_name_tells_its_device(tmp_path: Path) -> None:
    settings = OverheadSettings()
    assert overhead_device("camera", "bus", settings) is None
    assert rgbd_device("camera", "hider", "bus", 5.0) is None
    kinds = {"0": DrivenCamera, "/dev/video0": DrivenCamera, "table.mp4": VideoFile, str(tmp_path): PictureFolder}
    for source, kind in kinds.items():
        assert type(overhead_device("camera", source, settings)) is kind
    (tmp_path / "game.mcap").touch()
    kinds = {"realsense": RealSense, "realsense:12": RealSense, str(tmp_path): LoggedFrames, "frames": FrameFolder}
    for source, kind in kinds.items():
        assert type(rgbd_device("camera", "hider", source, 5.0)) is kind
