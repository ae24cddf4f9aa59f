"""An Intel RealSense as a device, through the optional package pyrealsense2."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from vantage.service import SECOND, DeviceLost, steady_clock

WAIT_MILLISECONDS = 200
SILENCE = 3.0
"""Seconds without a frame after which the camera counts as gone: the library itself does not tell a pulled cable."""


class RealSense:
    """Depth and colour of one camera, unaligned as its lenses give them: (uint16 [H, W] counts, uint8 [H, W, 3] RGB).

    Args:
        serial: number printed on the camera; empty: the only one that is plugged in.
        width, height, rate: of both streams, px and frames a second.
    """

    newest_only = True

    def __init__(self, name: str, serial: str, width: int = 640, height: int = 480, rate: int = 15) -> None:
        self.name = name
        self._serial, self._width, self._height, self._rate = serial, width, height, rate
        self._pipeline: Any = None
        self._heard = 0

    def open(self) -> None:
        try:
            import pyrealsense2 as library
        except ImportError as error:
            raise DeviceLost(f"{self.name}: pyrealsense2 is not installed: pip install 'vantage[realsense]'") from error
        found = [device.get_info(library.camera_info.serial_number) for device in library.context().query_devices()]
        if not found or (self._serial and self._serial not in found):
            there = f"there is {', '.join(found)}" if found else "there is none at all"
            raise DeviceLost(f"{self.name}: RealSense {self._serial or '(any)'} is not plugged in; {there}")
        if not self._serial and len(found) > 1:
            raise DeviceLost(f"{self.name}: several RealSense cameras ({', '.join(found)}): say which, realsense:SERIAL")
        configuration = library.config()
        configuration.enable_device(self._serial or found[0])
        size = (self._width, self._height)
        configuration.enable_stream(library.stream.depth, *size, library.format.z16, self._rate)
        configuration.enable_stream(library.stream.color, *size, library.format.rgb8, self._rate)
        self._pipeline = library.pipeline()
        try:
            self._pipeline.start(configuration)
        except RuntimeError as error:
            self._pipeline = None
            raise DeviceLost(
                f"{self.name}: the RealSense does not give {self._width} x {self._height} at {self._rate} a second "
                f"(a USB 2 cable does not carry it): {error}"
            ) from error
        self._heard = steady_clock()

    def read(self) -> tuple[tuple[npt.NDArray[np.uint16], npt.NDArray[np.uint8]], int] | None:
        there, frames = self._pipeline.try_wait_for_frames(WAIT_MILLISECONDS)
        now = steady_clock()
        if not there:
            if now - self._heard > SILENCE * SECOND:
                raise DeviceLost(f"{self.name}: the RealSense gives no frames any more: look at its cable")
            return None
        self._heard = now
        depth, color = frames.get_depth_frame(), frames.get_color_frame()
        if not depth or not color:
            return None
        # The library's clock is its own domain; half a period is what exposure and transfer take at least.
        stamp = now - SECOND // (2 * self._rate)
        return (np.asanyarray(depth.get_data()).copy(), np.asanyarray(color.get_data()).copy()), stamp

    def write(self, data: bytes) -> None:
        raise NotImplementedError("nothing is written to a camera")

    def close(self) -> None:
        if self._pipeline is not None:
            self._pipeline.stop()
            self._pipeline = None
