"""Sources of pictures, and what people are told when there is none."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from vantage.setting_up import pictures
from vantage.setting_up.pictures import open_source, read_picture, require_size, write_picture
from vantage.setting_up.trouble import TableTrouble


def striped(red: int) -> np.ndarray:
    picture = np.zeros((40, 60, 3), np.uint8)
    picture[:, ::2] = (red, 20, 200)
    return picture


def test_a_folder_is_read_in_order_of_names_and_in_rgb(tmp_path: Path) -> None:
    for name, red in (("b.png", 90), ("a.png", 30), ("c.bmp", 250)):
        write_picture(tmp_path / name, striped(red))
    (tmp_path / "notes.txt").write_text("no picture")
    with open_source(str(tmp_path), 640, 480) as source:
        assert (source.count, source.live) == (3, False)
        views = list(source.views)
    assert [view.name for view in views] == ["a.png", "b.png", "c.bmp"]
    assert [int(view.picture[0, 0, 0]) for view in views] == [30, 90, 250]
    assert int(views[0].picture[0, 0, 2]) == 200


def test_pictures_whose_metadata_ask_for_a_turn_are_read_as_the_sensor_took_them(tmp_path: Path) -> None:
    """Turned ones among others gave a lens whose principal point was mirrored."""
    for number, orientation in enumerate((1, 3, 6, 8)):
        upright = Image.fromarray(striped(90))
        exif = upright.getexif()
        exif[0x0112] = orientation
        upright.save(tmp_path / f"{number}.png", exif=exif)
    with open_source(str(tmp_path), 640, 480) as source:
        assert all((view.picture == striped(90)).all() for view in source.views)


def test_a_video_is_read_to_its_end(tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    for level in (20, 120, 220):
        writer.write(np.full((48, 64, 3), level, np.uint8))
    writer.release()
    with open_source(str(tmp_path / "v.avi"), 640, 480) as source:
        levels = [int(view.picture.mean()) for view in source.views]
    assert levels == pytest.approx([20, 120, 220], abs=4)


def test_a_camera_that_stops_giving_pictures_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A recording stands for the camera: its end is what an unplugged camera looks like."""
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    for _ in range(3):
        writer.write(np.full((48, 64, 3), 100, np.uint8))
    writer.release()
    monkeypatch.setattr(pictures, "_WARMING_UP", 0.0)
    capture = cv2.VideoCapture(str(tmp_path / "v.avi"))
    views = pictures._captured(capture, "camera 3", live=True)
    times = [next(views).seconds for _ in range(3)]
    assert times == sorted(times)
    with pytest.raises(TableTrouble, match="camera 3 gave no picture after 3: unplugged"):
        next(views)
    capture.release()


@pytest.mark.parametrize(
    ("source", "told"),
    [
        ("91", "/dev/video91 is not there: plug the camera in"),
        ("/dev/video91", "/dev/video91 is not there: plug the camera in"),
        ("nothing.png", "there is no picture nothing.png"),
        ("nothing", "no picture source `nothing`: give a camera"),
        ("nothing.mp4", "no picture source `nothing.mp4`"),
    ],
)
def test_what_is_not_there_is_said(source: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(TableTrouble, match=told), open_source(source, 640, 480):
        pass


def test_an_empty_folder_and_damaged_files_are_said(tmp_path: Path) -> None:
    with pytest.raises(TableTrouble, match="holds no picture: put PNG or JPEG files there"), open_source(str(tmp_path), 1, 1):
        pass
    for name in ("broken.png", "broken.mp4"):
        (tmp_path / name).write_bytes(b"this is no picture")
        with pytest.raises(TableTrouble, match="cannot be read as a"), open_source(str(tmp_path / name), 1, 1):
            pass


def test_a_wrong_size_names_both(tmp_path: Path) -> None:
    write_picture(tmp_path / "small.png", striped(1))
    with open_source(str(tmp_path / "small.png"), 1280, 720) as source:
        with pytest.raises(TableTrouble, match=r"small.png has 60 x 40 pixels, but the lens is for 1280 x 720"):
            require_size(source.first(), 1280, 720, "the lens")
        with pytest.raises(TableTrouble, match="gave no picture"):
            source.first()


def test_pictures_are_written_where_asked_or_refused(tmp_path: Path) -> None:
    write_picture(tmp_path / "new" / "folder" / "p.png", striped(77))
    assert (read_picture(tmp_path / "new" / "folder" / "p.png") == striped(77)).all()
    with pytest.raises(TableTrouble, match="does not name a picture"):
        write_picture(tmp_path / "p.txt", striped(1))
