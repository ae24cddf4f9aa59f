"""The pieces that Foxglove's messages are made of: times, places, colours, pictures."""

from __future__ import annotations

import math

from foxglove import messages as fox

from schemas import ColorImage, DepthImage, Intrinsics, Message
from vantage.log.appearance import Picture, row_repeats


def time_of(message: Message) -> fox.Timestamp:
    """Return the moment of capture."""
    return fox.Timestamp(sec=message.stamp // 1_000_000_000 % 2**32, nsec=message.stamp % 1_000_000_000)


def placed(x: float, y: float, z: float, heading: float = 0.0) -> fox.Pose:
    """Return a pose from m and rad."""
    return fox.Pose(position=fox.Vector3(x=x, y=y, z=z), orientation=turned(heading))


def turned(heading: float) -> fox.Quaternion:
    """Return a turn about z, rad."""
    return fox.Quaternion(x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2))


def colored(red: float, green: float, blue: float, alpha: float = 1.0) -> fox.Color:
    """Return a colour from 0..255, and alpha 0..1."""
    return fox.Color(r=red / 255, g=green / 255, b=blue / 255, a=alpha)


def image_of(message: Message, frame: str, picture: Picture) -> fox.RawImage:
    """Return a picture, uint8 [H, W, 3] RGB."""
    height, width, _ = picture.shape
    return fox.RawImage(
        timestamp=time_of(message),
        frame_id=frame,
        width=width,
        height=height,
        encoding="rgb8",
        step=3 * width,
        data=picture.tobytes(),
    )


def camera_image_of(message: DepthImage | ColorImage, robot: str, encoding: str, pixel: int) -> fox.RawImage:
    """A picture of few rows (the one-row camera) is shown with its rows repeated, or nobody would see it."""
    repeats = row_repeats(message.height)
    step = message.width * pixel
    data = message.data
    if repeats > 1:
        data = b"".join(data[row * step : (row + 1) * step] * repeats for row in range(message.height))
    return fox.RawImage(
        timestamp=time_of(message),
        frame_id=f"{robot}/camera",
        width=message.width,
        height=message.height * repeats,
        encoding=encoding,
        step=step,
        data=data,
    )


def calibration_of(message: DepthImage, robot: str, lens: Intrinsics) -> fox.CameraCalibration:
    """Return the lens of a robot's camera."""
    return fox.CameraCalibration(
        timestamp=time_of(message),
        frame_id=f"{robot}/camera",
        width=message.width,
        height=message.height,
        distortion_model="plumb_bob",
        D=[0.0] * 5,
        K=[lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[lens.fx, 0.0, lens.cx, 0.0, 0.0, lens.fy, lens.cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )
