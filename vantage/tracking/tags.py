"""Finding AprilTags (tag36h11) in windows of a picture, with pupil-apriltags."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from pupil_apriltags import Detector

from vantage.tracking.table import TAG_CELLS

Floats = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]
Window = tuple[int, int, int, int]
"""Left, top, right, bottom px; right and bottom are outside."""

UPRIGHT_CORNERS: Floats = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
"""Corners of a tag of side 1 on its own axes, in the order in which they are found; float64 [4, 2]."""

SMALLEST_FOR_HALF = 30.0
"""px: tags whose black square is at least so wide are sought in the picture halved."""


@dataclass(frozen=True, slots=True)
class FoundTag:
    """A tag in a picture.

    Attributes:
        id: in the family.
        corners: of the black square, float64 [4, 2] px in the order of UPRIGHT_CORNERS, integer coordinates = pixel centres.
        margin: contrast of the bits that were read; below about 30 the picture is blurred or noisy.
    """

    id: int
    corners: Floats
    margin: float

    @property
    def centre(self) -> Floats:
        """Mean of the corners, float64 [2] px."""
        return np.asarray(self.corners.mean(axis=0))

    @property
    def width(self) -> float:
        """Mean side, px."""
        return float(np.linalg.norm(self.corners - np.roll(self.corners, 1, axis=0), axis=1).mean())


def tag_cells(tag: int) -> Picture:
    """Return the cells of an upright tag with its white border: uint8 [10, 10], 0 or 255, row 0 at the top.

    OpenCV draws the family turned by half a turn against the family's own pictures and detector.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    cells = np.rot90(cv2.aruco.generateImageMarker(dictionary, tag, TAG_CELLS, borderBits=1), 2)
    return np.asarray(np.pad(cells, 1, constant_values=255), dtype=np.uint8)


def grey_of(picture: Picture, window: Window) -> Picture:
    """Return a window of a grey or RGB picture as contiguous grey, uint8 [h, w]."""
    left, top, right, bottom = window
    part = picture[top:bottom, left:right]
    return cv2.cvtColor(part, cv2.COLOR_RGB2GRAY) if part.ndim == 3 else np.ascontiguousarray(part)


class _Detector(Detector):
    """The one detector of a process, which keeps it to its end.

    To free it crashes (pupil-apriltags frees the families before the detector, which reads them once more: its issues 34, 46
    and 52), and freed in the right order it still leaves 35 MB of decoding tables behind.
    """

    def __init__(self) -> None:
        super().__init__(families="tag36h11", nthreads=1, refine_edges=1)
        self.lock = threading.Lock()

    def __del__(self) -> None:
        pass

    def at(self, half: bool, grey: Picture) -> list[Any]:
        """Detect in a grey picture uint8 [h, w], with quads sought at full or at half resolution."""
        with self.lock:
            self.tag_detector_ptr.contents.quad_decimate = 2.0 if half else 1.0
            return list(self.detect(grey))


@lru_cache(maxsize=1)
def _detector() -> _Detector:
    return _Detector()


class TagFinder:
    """Finds tags in windows of pictures, on one thread."""

    def __init__(self) -> None:
        self._detector = _detector()

    def find(self, picture: Picture, window: Window, half: bool) -> list[FoundTag]:
        """Find all tags in a window of a picture (uint8 [H, W] or [H, W, 3] RGB), none of them corrected by more than one bit."""
        if window[2] - window[0] < 16 or window[3] - window[1] < 16:
            return []
        grey = grey_of(picture, window)
        # The detector's coordinates are 0.5 at the centre of the first pixel.
        offset = np.array([window[0] - 0.5, window[1] - 0.5])
        return [
            FoundTag(int(found.tag_id), np.asarray(found.corners, dtype=np.float64) + offset, float(found.decision_margin))
            for found in self._detector.at(half, grey)
            if found.hamming <= 1
        ]


def distinct(found: list[FoundTag]) -> list[FoundTag]:
    """Drop what was found a second time at the same place, as in overlapping windows."""
    kept: list[FoundTag] = []
    for tag in found:
        same = [other for other in kept if other.id == tag.id and np.linalg.norm(other.centre - tag.centre) < tag.width / 2]
        if not same:
            kept.append(tag)
    return kept
