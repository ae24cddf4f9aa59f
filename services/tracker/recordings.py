"""Recorded RGB-D streams as devices: a folder of frames, or a log of ours.

A frame is (depth uint16 [H, W] in counts of the camera, colour uint8 [H, W, 3] RGB).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from schemas import ColorImage, DepthImage
from services.tracker.devices import PacedFrames
from vantage.log import read
from vantage.service import DeviceLost
from vantage.tracking.picture_file import UnreadableArrays, read_arrays, read_pixels

RgbdFrame = tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint8]]


class FrameFolder(PacedFrames):
    """A folder of `NAME.npz` with the arrays `depth` and `color`, or of pairs `NAME.depth.png` (16 bit) and `NAME.color.png`."""

    def frames(self) -> Iterator[RgbdFrame]:
        paths = sorted(p for p in self._source.iterdir() if p.suffix == ".npz" or p.name.endswith(".depth.png"))
        if not paths:
            raise DeviceLost(f"{self.name}: {self._source} holds neither *.npz nor *.depth.png")
        for path in paths:
            yield self._read_arrays(path) if path.suffix == ".npz" else self._read_pair(path)

    def _read_arrays(self, path: Path) -> RgbdFrame:
        try:
            depth, color = read_arrays(path, "depth", "color")
        except UnreadableArrays as error:
            raise DeviceLost(f"{self.name}: {error}") from error
        return self._checked(path, depth, color)

    def _read_pair(self, path: Path) -> RgbdFrame:
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        color = read_pixels(path.with_name(path.name.removesuffix(".depth.png") + ".color.png"))
        if depth is None or color is None:
            raise DeviceLost(f"{self.name}: {path} or the .color.png beside it cannot be read")
        return self._checked(path, depth, color)

    def _checked(self, path: Path, depth: npt.NDArray[np.generic], color: npt.NDArray[np.generic]) -> RgbdFrame:
        if depth.dtype != np.uint16 or depth.ndim != 2 or color.dtype != np.uint8 or color.shape[2:] != (3,):
            raise DeviceLost(f"{self.name}: {path} must hold depth uint16 [H, W] and color uint8 [H, W, 3]")
        return depth.astype(np.uint16, copy=False), color.astype(np.uint8, copy=False)


class LoggedFrames(PacedFrames):
    """A robot's pictures of the steps out of an MCAP log; cameras' raw frames are not recorded.

    They are level and registered already: they need a calibration that says so.
    """

    def __init__(self, name: str, source: Path, rate: float, robot: str) -> None:
        super().__init__(name, source, rate)
        self._robot = robot

    def frames(self) -> Iterator[RgbdFrame]:
        found = False
        keys = (f"{self._robot}/depth", f"{self._robot}/color")
        halves: dict[str, DepthImage | ColorImage] = {}
        for record in read(self._source, keys):
            message = record.decode()
            assert isinstance(message, DepthImage | ColorImage)
            halves[record.key] = message
            depth, color = halves.get(keys[0]), halves.get(keys[1])
            if depth is not None and color is not None and depth.stamp == color.stamp:
                found = True
                yield (
                    np.frombuffer(depth.data, "<u2").reshape(depth.height, depth.width),
                    np.frombuffer(color.data, np.uint8).reshape(color.height, color.width, 3),
                )
        if not found:
            raise DeviceLost(f"{self.name}: {self._source} holds no depth and colour pictures of the {self._robot}")
