"""A calibrated camera over the table: from points to pixels, and from pixels back to a plane above the floor.

Integer pixel coordinates are pixel centres (OpenCV's convention).
"""

from __future__ import annotations

import datetime
from typing import Annotated

import cv2
import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Meta

Floats = npt.NDArray[np.float64]


class Calibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Lens and place of the overhead camera."""

    width: Annotated[int, Meta(ge=16, le=16384, description="of the pictures, px")]
    height: Annotated[int, Meta(ge=16, le=16384, description="of the pictures, px")]
    matrix: Annotated[tuple[float, ...], Meta(min_length=9, max_length=9, description="3 x 3 by rows, px")]
    distortion: Annotated[tuple[float, ...], Meta(min_length=5, max_length=5, description="k1, k2, p1, p2, k3")]
    rotation: Annotated[tuple[float, ...], Meta(min_length=9, max_length=9, description="3 x 3 by rows, arena -> camera")]
    translation: Annotated[tuple[float, ...], Meta(min_length=3, max_length=3, description="arena -> camera, m")]
    lens_residual: Annotated[float, Meta(ge=0.0, description="px, root mean square")]
    arena_residual: Annotated[float, Meta(ge=0.0, description="mm on the floor, root mean square")]
    date: Annotated[datetime.date, Meta(description="of the arena calibration")]
    made_with: str = ""


class OverheadCamera:
    """Projection by pinhole, distortion and place over the arena.

    Attributes:
        matrix: float64 [3, 3], px.
        distortion: float64 [5].
        rotation: float64 [3, 3], arena -> camera.
        translation: float64 [3], m.
        centre: float64 [3], the optical centre in the arena frame, m.
    """

    def __init__(self, calibration: Calibration) -> None:
        self.width, self.height = calibration.width, calibration.height
        self.matrix: Floats = np.array(calibration.matrix, dtype=np.float64).reshape(3, 3)
        self.distortion: Floats = np.array(calibration.distortion, dtype=np.float64)
        self.rotation: Floats = np.array(calibration.rotation, dtype=np.float64).reshape(3, 3)
        self.translation: Floats = np.array(calibration.translation, dtype=np.float64)
        self.centre: Floats = -self.rotation.T @ self.translation
        self._rotation_vector: Floats = cv2.Rodrigues(self.rotation)[0]
        self._homographies: dict[float, Floats] = {}

    def project(self, points: Floats) -> Floats:
        """Return where points float64 [n, 3] (m) appear, float64 [n, 2] px."""
        pixels, _ = cv2.projectPoints(
            np.asarray(points, dtype=np.float64).reshape(-1, 1, 3),
            self._rotation_vector,
            self.translation,
            self.matrix,
            self.distortion,
        )
        return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)

    def undistort(self, pixels: Floats) -> Floats:
        """Return the slopes of the rays through pixels float64 [n, 2], float64 [n, 2] per unit of depth."""
        rays = cv2.undistortPoints(np.asarray(pixels, dtype=np.float64).reshape(-1, 1, 2), self.matrix, self.distortion)
        return np.asarray(rays, dtype=np.float64).reshape(-1, 2)

    def homography(self, height: float) -> Floats:
        """Return the map from ray slopes to x, y on the plane at a height (m), float64 [3, 3]."""
        found = self._homographies.get(height)
        if found is None:
            columns = (self.rotation[:, 0], self.rotation[:, 1], self.rotation[:, 2] * height + self.translation)
            found = self._homographies[height] = np.linalg.inv(np.stack(columns, axis=1))
        return found

    def on_plane(self, pixels: Floats, height: float) -> tuple[Floats, Floats]:
        """Intersect the rays through pixels float64 [n, 2] with the plane at a height, m.

        Returns:
            x, y float64 [n, 2] in m, and their derivatives by the pixel float64 [n, 2, 2] in m per px (without those of the
            distortion, a few per cent).
        """
        rays = self.undistort(pixels)
        homography = self.homography(height)
        mapped = rays @ homography[:, :2].T + homography[:, 2]  # [n, 3]
        points = mapped[:, :2] / mapped[:, 2:]
        slopes = (homography[None, :2, :2] - points[:, :, None] * homography[None, 2:, :2]) / mapped[:, 2, None, None]
        return points, slopes / np.array([self.matrix[0, 0], self.matrix[1, 1]])

    def scale_at(self, height: float) -> float:
        """Return px per m on the plane at a height, under the camera."""
        return float((self.matrix[0, 0] + self.matrix[1, 1]) / 2 / max(self.centre[2] - height, 1e-3))
