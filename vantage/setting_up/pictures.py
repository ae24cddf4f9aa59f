"""Where pictures for setting up come from: a camera, a picture, a folder of pictures or a video. RGB throughout.

Files are read as the sensor took them, whatever turn their metadata ask for (`vantage.tracking.picture_file`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from vantage.output import write_complete
from vantage.setting_up.trouble import TableTrouble
from vantage.tracking.picture_file import open_video, read_pixels
from vantage.tracking.video_capture import FOURCC, RATE, CameraMode, UnusableCamera, open_camera

Picture = npt.NDArray[np.uint8]

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".webm", ".mjpeg", ".m4v")
_WARMING_UP = 1.0
"""Seconds that a camera gets for its exposure to settle."""


@dataclass(frozen=True, slots=True)
class View:
    """One picture.

    Attributes:
        name: of the file, or a number.
        picture: uint8 [H, W, 3], red green blue.
        seconds: since the source was opened, for a camera; else 0.
    """

    name: str
    picture: Picture
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class Source:
    """An open source.

    Attributes:
        count: how many pictures there are, None where nobody knows (a camera).
        views: the pictures, in order; of a camera without end.
    """

    name: str
    live: bool
    count: int | None
    views: Iterator[View]

    def first(self) -> View:
        """Return the next picture.

        Raises:
            TableTrouble: there is none.
        """
        view = next(self.views, None)
        if view is None:
            raise TableTrouble(f"{self.name} gave no picture: is it an empty video, or the wrong camera?")
        return view


def read_picture(path: Path) -> Picture:
    """Return a picture file, uint8 [H, W, 3], RGB.

    Raises:
        TableTrouble: there is none, or it is no picture.
    """
    if not path.is_file():
        raise TableTrouble(f"there is no picture {path}")
    picture = read_pixels(path)
    if picture is None:
        raise TableTrouble(f"{path} cannot be read as a picture: give a PNG or JPEG file")
    return picture


def write_picture(path: Path, picture: Picture) -> None:
    """Write uint8 [H, W, 3] RGB as PNG or JPEG, by the name's ending, in one step; folders are made.

    Raises:
        TableTrouble: the name is not that of a picture.
        OSError: it cannot be written there.
    """
    if path.suffix.lower() not in PICTURES:
        raise TableTrouble(f"{path} does not name a picture: end it in .png or .jpg")
    encoded, content = cv2.imencode(path.suffix, np.ascontiguousarray(picture[..., ::-1]))
    if not encoded:
        raise TableTrouble(f"OpenCV does not write {path.suffix} pictures here: end {path} in .png or .jpg")
    write_complete(path, content.tobytes())


@contextmanager
def open_source(source: str, width: int, height: int, rate: float = RATE, fourcc: str = FOURCC) -> Iterator[Source]:
    """Open a camera (`0`, `1`, `/dev/video0`), a picture, a folder of pictures or a video.

    Args:
        width, height, rate, fourcc: asked of a camera: px, frames a second, pixel format.

    Raises:
        TableTrouble: there is no such thing, it holds no picture, or the camera cannot be opened or does otherwise than asked.
    """
    path = Path(source)
    if source.isdecimal() or source.startswith("/dev/"):
        try:
            capture = open_camera(source, CameraMode(width, height, rate, fourcc))
        except UnusableCamera as error:
            raise TableTrouble(str(error)) from error
        try:
            yield Source(f"camera {source}", True, None, _captured(capture, f"camera {source}", live=True))
        finally:
            capture.release()
    elif path.is_dir():
        files = sorted(file for file in path.iterdir() if file.suffix.lower() in PICTURES)
        if not files:
            raise TableTrouble(f"{path} holds no picture: put PNG or JPEG files there (it looks for {', '.join(PICTURES)})")
        yield Source(str(path), False, len(files), (View(file.name, read_picture(file)) for file in files))
    elif path.suffix.lower() in VIDEOS and path.is_file():
        capture = open_video(path)
        try:
            if not capture.isOpened():
                raise TableTrouble(f"{path} cannot be read as a video: record it as MJPEG or MP4")
            count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
            yield Source(str(path), False, count if count > 0 else None, _captured(capture, path.name, live=False))
        finally:
            capture.release()
    elif path.suffix.lower() in PICTURES:
        picture = read_picture(path)
        yield Source(str(path), False, 1, iter([View(path.name, picture)]))
    else:
        raise TableTrouble(
            f"there is no picture source `{source}`: give a camera (0, /dev/video0), a picture, a folder of pictures or a video"
        )


def require_size(view: View, width: int, height: int, of: str) -> None:
    """Refuse a picture that is not of the size of something else (a calibration).

    Raises:
        TableTrouble: it is not.
    """
    rows, columns = view.picture.shape[:2]
    if (columns, rows) != (width, height):
        raise TableTrouble(
            f"{view.name} has {columns} x {rows} pixels, but {of} is for {width} x {height}: "
            "set the camera to the same resolution (--width, --height), or calibrate the lens again at this one"
        )


def _captured(capture: Any, name: str, *, live: bool) -> Iterator[View]:
    opened = time.monotonic()
    number = 0
    while True:
        got, picture = capture.read()
        seconds = time.monotonic() - opened
        if not got:
            if live:
                raise TableTrouble(f"{name} gave no picture after {number}: unplugged, or too little bandwidth on its USB bus?")
            return
        number += 1
        if not live or seconds >= _WARMING_UP:
            yield View(f"{name}, picture {number}", np.ascontiguousarray(picture[..., ::-1]), seconds if live else 0.0)
