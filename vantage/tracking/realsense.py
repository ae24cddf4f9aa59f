"""Opens an Intel RealSense, through the optional package pyrealsense2."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from vantage.tracking.video_capture import UnusableCamera

RATE = 15


def load_library() -> Any:
    """Return the package.

    Raises:
        UnusableCamera: it is not installed.
    """
    try:
        import pyrealsense2 as library
    except ImportError as error:
        raise UnusableCamera(
            'pyrealsense2 is not installed: in the repository, `.venv/bin/pip install --editable ".[tracker,realsense]"`'
        ) from error
    return library


def open_realsense(library: Any, serial: str, width: int, height: int, rate: int = RATE) -> tuple[Any, Any]:
    """Start depth and colour of one camera, unaligned. Returns its pipeline and the profile of its streams.

    Args:
        serial: number printed on the camera; empty: the only one that is plugged in.
        width, height, rate: of both streams, px and frames a second.

    Raises:
        UnusableCamera: it is not plugged in, several are, or it does not do what is asked.
    """
    found = [device.get_info(library.camera_info.serial_number) for device in library.context().query_devices()]
    if not found or (serial and serial not in found):
        there = f"there is {', '.join(found)}" if found else "there is none at all"
        raise UnusableCamera(f"RealSense {serial or '(any)'} is not plugged in; {there}")
    if not serial and len(found) > 1:
        raise UnusableCamera(f"several RealSense cameras ({', '.join(found)}): say which, realsense:SERIAL")
    configuration = library.config()
    configuration.enable_device(serial or found[0])
    configuration.enable_stream(library.stream.depth, width, height, library.format.z16, rate)
    configuration.enable_stream(library.stream.color, width, height, library.format.rgb8, rate)
    pipeline = library.pipeline()
    try:
        return pipeline, pipeline.start(configuration)
    except RuntimeError as error:
        raise UnusableCamera(
            f"the RealSense does not give {width} x {height} at {rate} a second "
            f"(a USB 2 cable does not carry it, or the deployment holds it): {error}"
        ) from error


def stop_realsense(pipeline: Any) -> None:
    """Stop a pipeline; one whose camera was pulled out says that it never ran."""
    with suppress(RuntimeError):
        pipeline.stop()
