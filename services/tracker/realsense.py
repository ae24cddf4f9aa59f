"""An Intel RealSense as a device."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import numpy.typing as npt

from vantage.service import SECOND, DeviceLost, steady_clock
from vantage.tracking.realsense import RATE, load_library, open_realsense, stop_realsense
from vantage.tracking.video_capture import UnusableCamera

WAIT_MILLISECONDS = 200
SILENCE = 3.0
"""Seconds without a frame after which the camera counts as gone: the library itself does not tell a pulled cable."""
LATENCY = 0.05
"""Seconds from exposure to arrival, where the camera's own stamps are not of this machine's clock."""


class RealSense:
    """Depth and colour of one camera, unaligned as its lenses give them: (uint16 [H, W] counts, uint8 [H, W, 3] RGB).

    Args:
        serial: number printed on the camera; empty: the only one that is plugged in.
        width, height, rate: of both streams, px and frames a second.
    """

    newest_only = True

    def __init__(self, name: str, serial: str, width: int = 640, height: int = 480, rate: int = RATE) -> None:
        self.name = name
        self._serial, self._width, self._height, self._rate = serial, width, height, rate
        self._library: Any = None
        self._pipeline: Any = None
        self._heard = 0

    def open(self) -> None:
        try:
            self._library = load_library()
            self._pipeline, _ = open_realsense(self._library, self._serial, self._width, self._height, self._rate)
        except UnusableCamera as error:
            raise DeviceLost(f"{self.name}: {error}") from error
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
        # The earlier of the two: a step counts what was captured after its motions.
        age = max(self._age(depth), self._age(color))
        return (np.asanyarray(depth.get_data()).copy(), np.asanyarray(color.get_data()).copy()), now - int(age * SECOND)

    def _age(self, frame: Any) -> float:
        """Seconds since a frame was captured: by its own stamp (ms since the Unix epoch) if that is of this machine's clock."""
        domain = self._library.timestamp_domain
        age = time.time() - frame.get_timestamp() / 1000.0
        of_this_machine = frame.get_frame_timestamp_domain() in (domain.system_time, domain.global_time)
        return age if of_this_machine and 0.0 <= age < 1.0 else LATENCY

    def write(self, data: bytes) -> None:
        raise NotImplementedError("nothing is written to a camera")

    def close(self) -> None:
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            stop_realsense(pipeline)
