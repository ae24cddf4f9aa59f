"""Pictures, videos and recorded arrays on disk, read as the sensor took them, and no larger than a camera gives them.

A turn that their metadata ask for (EXIF orientation, a video's rotation) is not made: a lens is calibrated in the sensor's
pixels, and turned pictures among others would give it a principal point at the wrong side.
"""

from __future__ import annotations

import math
import zipfile
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from vantage.tracking.errors import TrackingError

LARGEST_ARRAY = 3 * 4096 * 4096
"""Bytes of a recorded array, at most."""


class UnreadableArrays(TrackingError):
    """A file does not hold the arrays that it should, or not of a size that a camera gives."""


def read_pixels(path: Path) -> npt.NDArray[np.uint8] | None:
    """Return a picture file's pixels, uint8 [H, W, 3] RGB; None where OpenCV cannot read it."""
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return None if picture is None else np.ascontiguousarray(picture[..., ::-1], dtype=np.uint8)


def open_video(path: Path) -> Any:
    """Return a video file's `cv2.VideoCapture`, to be released by the caller; ask it whether it is opened."""
    capture = cv2.VideoCapture(str(path))
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return capture


def read_arrays(path: Path, *names: str) -> list[npt.NDArray[Any]]:
    """Return named arrays of an `.npz` file. What headers claim is checked before anything is unpacked, nothing is unpickled.

    Raises:
        UnreadableArrays: they are not there, damaged, or larger than any picture.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return [_read_array(archive, name) for name in names]
    except (
        *(OSError, EOFError, ValueError, KeyError, RuntimeError, NotImplementedError, MemoryError),
        *(zipfile.BadZipFile, zlib.error),
    ) as error:
        raise UnreadableArrays(
            f"{path} does not hold the array{'s' * (len(names) > 1)} {' and '.join(names)}: {error}"
        ) from error


def _read_array(archive: zipfile.ZipFile, name: str) -> npt.NDArray[Any]:
    member = archive.getinfo(f"{name}.npy")
    with archive.open(member) as file:
        read_header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}.get(npy.read_magic(file))
        if read_header is None:
            raise ValueError(f"{name} is of a newer format than this NumPy reads")
        shape, _, kind = read_header(file)
    if max(member.file_size, math.prod(shape) * kind.itemsize) > LARGEST_ARRAY:
        raise ValueError(f"{name} is {' x '.join(map(str, shape))}, larger than any picture")
    with archive.open(member) as file:
        array: npt.NDArray[Any] = npy.read_array(file, allow_pickle=False)
    return array
