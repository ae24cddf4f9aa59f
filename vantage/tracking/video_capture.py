"""Opens V4L2 and USB cameras in one mode, and reads back whether they took it: a calibration holds for one mode alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from vantage.tracking.errors import TrackingError

RATE = 30.0
FOURCC = "MJPG"
READ_TIMEOUT = 2000
"""ms without a frame after which a read fails, where OpenCV's reader of the camera knows such a limit."""
_MANUAL, _AUTOMATIC = 1, 3
"""V4L2's words for who sets the exposure."""


class UnusableCamera(TrackingError):
    """A camera is not there, does not open, or does not do what is asked of it."""


@dataclass(frozen=True)
class CameraMode:
    """What is asked of a camera.

    Attributes:
        width, height: px.
        rate: frames a second.
        fourcc: pixel format, four letters.
        exposure: in the camera's own unit (V4L2: 100 us); None: automatic.
    """

    width: int
    height: int
    rate: float = RATE
    fourcc: str = FOURCC
    exposure: float | None = None


def open_camera(source: str, mode: CameraMode) -> Any:
    """Open a camera by number or path in a mode. Returns the `cv2.VideoCapture`, to be released by the caller.

    Raises:
        UnusableCamera: it is not there, does not open, or does otherwise than asked.
    """
    path = Path(f"/dev/video{source}") if source.isdecimal() else Path(source)
    if len(mode.fourcc) != 4:
        raise UnusableCamera(f"`{mode.fourcc}` is no pixel format: give its four letters, as MJPG or YUYV")
    if not path.exists():
        raise UnusableCamera(f"{path} is not there: plug the camera in; {_cameras_there()}")
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what goes wrong is said below, for people
    capture = cv2.VideoCapture(str(path), cv2.CAP_V4L2)
    if not capture.isOpened():
        raise UnusableCamera(
            f"{path} does not open: another program has it (`fuser {path}`; `vantage down hardware` frees the tracker's), "
            "you are not in the group `video`, or it is no camera"
        )
    if (timeout := getattr(cv2, "CAP_PROP_READ_TIMEOUT_MSEC", None)) is not None:
        capture.set(timeout, READ_TIMEOUT)
    capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*mode.fourcc))
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, mode.width)
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, mode.height)
    capture.set(cv2.CAP_PROP_FPS, mode.rate)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    if mode.exposure is None:
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _AUTOMATIC)
    else:
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL)
        capture.set(cv2.CAP_PROP_EXPOSURE, mode.exposure)
    if refused := refusals(mode, capture.get):
        capture.release()
        raise UnusableCamera(
            f"{path} does not do {', '.join(refused)}: see `v4l2-ctl -d {path} --list-formats-ext`, "
            "choose what it does and calibrate for it"
        )
    return capture


def refusals(mode: CameraMode, get: Callable[[int], float]) -> list[str]:
    """Return what a camera, read back through `get(OpenCV property)`, does otherwise than asked, in words."""
    refused = []
    width, height = round(get(cv2.CAP_PROP_FRAME_WIDTH)), round(get(cv2.CAP_PROP_FRAME_HEIGHT))
    if (width, height) != (mode.width, mode.height):
        refused.append(f"{mode.width} x {mode.height} pixels (it gives {width} x {height})")
    rate = get(cv2.CAP_PROP_FPS)
    if abs(rate - mode.rate) > 0.1 * mode.rate:
        refused.append(f"{mode.rate:g} frames a second (it gives {rate:g})")
    fourcc = _letters(int(get(cv2.CAP_PROP_FOURCC)))
    if fourcc != mode.fourcc:
        refused.append(f"the format {mode.fourcc} (it {f'gives {fourcc}' if fourcc else 'does not say which it gives'})")
    if mode.exposure is not None:
        exposure = get(cv2.CAP_PROP_EXPOSURE)
        if abs(exposure - mode.exposure) > 0.1 * abs(mode.exposure) + 1e-9:
            refused.append(f"an exposure of {mode.exposure:g} (it keeps {exposure:g})")
    return refused


def _letters(code: int) -> str:
    """Return a pixel format's four letters, empty where there is none: OpenCV says 0 or -1 then."""
    return code.to_bytes(4, "little").decode(errors="replace") if 0 < code < 1 << 32 else ""


def _cameras_there() -> str:
    found = sorted(str(path) for path in Path("/dev").glob("video*"))
    return f"there is {', '.join(found)}" if found else "there is no camera at all"
