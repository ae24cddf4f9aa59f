"""From the corners of a tag to the pose of what carries it, with covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vantage.tracking.overhead_camera import OverheadCamera
from vantage.tracking.tags import UPRIGHT_CORNERS

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MeasuredPose:
    """A pose from one tag in one picture.

    Attributes:
        pose: float64 [3]: x, y (m), heading (rad, within pi of 0).
        covariance: float64 [3, 3].
        residual: root mean square distance of the four corners from where they belong, m.
        scale: measured over true side of the tag; unlike 1 when the tag is not at its height or not of its size.
    """

    pose: Floats
    covariance: Floats
    residual: float
    scale: float


def wrapped(angle: float) -> float:
    """Return the same direction within pi of 0, rad."""
    return math.remainder(angle, 2.0 * math.pi)


def mounted_corners(size: float, forward: float, left: float, heading: float) -> Floats:
    """Return the corners of a tag on the axes of what carries it, float64 [4, 2] m."""
    cosine, sine = math.cos(heading), math.sin(heading)
    turned = size * UPRIGHT_CORNERS @ np.array([[cosine, sine], [-sine, cosine]])
    return turned + np.array([forward, left])


def measure_pose(camera: OverheadCamera, corners: Floats, mounted: Floats, height: float, sigma: float) -> MeasuredPose:
    """Find the rigid motion that takes a tag's mounted corners to where the camera sees them on the plane at a height.

    Weighted least squares over x, y and heading, begun from the closed solution (Procrustes), with the corners' covariances
    propagated from the picture.

    Args:
        camera: calibrated.
        corners: seen, float64 [4, 2] px.
        mounted: the same corners on the axes of what carries the tag, float64 [4, 2] m.
        height: of the tag above the floor, m.
        sigma: of a corner in the picture, px each way.
    """
    points, slopes = camera.on_plane(corners, height)
    information = np.linalg.inv(sigma * sigma * slopes @ slopes.transpose(0, 2, 1))  # [4, 2, 2]
    middle, mounted_middle = points.mean(axis=0), mounted.mean(axis=0)
    seen, known = points - middle, mounted - mounted_middle
    along = float((known * seen).sum())
    across = float((known[:, 0] * seen[:, 1] - known[:, 1] * seen[:, 0]).sum())
    heading = math.atan2(across, along)
    scale = math.hypot(across, along) / float((known * known).sum())
    x, y = middle - _turned(mounted_middle[None], heading)[0]
    for _ in range(2):
        turned = _turned(mounted, heading)
        design = np.zeros((4, 2, 3))
        design[:, 0, 0] = design[:, 1, 1] = 1.0
        design[:, 0, 2], design[:, 1, 2] = -turned[:, 1], turned[:, 0]
        left = points - turned - np.array([x, y])
        weighted = design.transpose(0, 2, 1) @ information  # [4, 3, 2]
        covariance = np.linalg.inv((weighted @ design).sum(axis=0))
        step = covariance @ (weighted @ left[:, :, None]).sum(axis=0)[:, 0]
        x, y, heading = x + step[0], y + step[1], heading + step[2]
    left = points - _turned(mounted, heading) - np.array([x, y])
    residual = math.sqrt(float((left * left).sum()) / 4)
    return MeasuredPose(np.array([x, y, wrapped(heading)]), covariance, residual, scale)


def _turned(points: Floats, heading: float) -> Floats:
    cosine, sine = math.cos(heading), math.sin(heading)
    return points @ np.array([[cosine, sine], [-sine, cosine]])
