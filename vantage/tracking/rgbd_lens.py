"""A lens: pinhole with OpenCV's five distortion coefficients, and the rays of its pixels.

Frame of a lens: x right, y down, z along the optical axis, m; integer pixel coordinates are pixel centres.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

_ITERATIONS = 40
_CONVERGED = 1e-6


class Lens(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Intrinsics of one of the two lenses of an RGB-D camera."""

    width: Annotated[int, msgspec.Meta(ge=8, le=4096)]
    """px"""
    height: Annotated[int, msgspec.Meta(ge=8, le=4096)]
    """px"""
    fx: Annotated[float, msgspec.Meta(gt=0.0, le=1e5)]
    """px"""
    fy: Annotated[float, msgspec.Meta(gt=0.0, le=1e5)]
    """px"""
    cx: Annotated[float, msgspec.Meta(ge=-1e5, le=1e5)]
    """px"""
    cy: Annotated[float, msgspec.Meta(ge=-1e5, le=1e5)]
    """px"""
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3 as in OpenCV"""


def lens_of(width: int, height: int, horizontal_fov: float) -> Lens:
    """An undistorted lens with square pixels and its axis through the middle; `horizontal_fov` in rad, between outer edges."""
    focal = width / (2.0 * math.tan(horizontal_fov / 2.0))
    return Lens(width=width, height=height, fx=focal, fy=focal, cx=(width - 1) / 2.0, cy=(height - 1) / 2.0)


def _distort(lens: Lens, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    k1, k2, p1, p2, k3 = lens.distortion
    square = x * x + y * y
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
        y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
    )


def project(lens: Lens, points: Floats) -> Floats:
    """Pixel coordinates of points before the lens: float64 [..., 3] m -> [..., 2] px (OpenCV's `projectPoints`)."""
    x, y = _distort(lens, points[..., 0] / points[..., 2], points[..., 1] / points[..., 2])
    return np.stack((lens.fx * x + lens.cx, lens.fy * y + lens.cy), axis=-1)


def pixel_rays(lens: Lens) -> Floats:
    """Slopes x / z and y / z of what each pixel looks at: float64 [H, W, 2].

    The distortion is undone by fixed-point iteration (OpenCV's `undistortPoints`), run until it stands still. Raises
    ValueError where it does not: then no ray belongs to some pixel, and the coefficients are wrong.
    """
    u, v = np.meshgrid(np.arange(lens.width, dtype=np.float64), np.arange(lens.height, dtype=np.float64))
    wanted_x, wanted_y = (u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy
    if not any(lens.distortion):
        return np.stack((wanted_x, wanted_y), axis=-1)
    x, y = wanted_x.copy(), wanted_y.copy()
    with np.errstate(all="ignore"):
        for _ in range(_ITERATIONS):
            got_x, got_y = _distort(lens, x, y)
            x += wanted_x - got_x
            y += wanted_y - got_y
        got_x, got_y = _distort(lens, x, y)
        off = np.hypot(got_x - wanted_x, got_y - wanted_y)
    if not np.all(off < _CONVERGED):
        raise ValueError("the lens's distortion cannot be undone within its picture; calibrate the lens again")
    return np.stack((x, y), axis=-1)
