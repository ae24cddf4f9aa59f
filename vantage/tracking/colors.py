"""Colours of the robots as a camera sees them, and the correction that makes them the canonical ones."""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]

Finite = Annotated[float, msgspec.Meta(ge=-1e4, le=1e4)]


class ColorCorrection(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """corrected = matrix @ measured + offset, RGB 0..255."""

    matrix: tuple[Finite, Finite, Finite, Finite, Finite, Finite, Finite, Finite, Finite] = (
        *(1.0, 0.0, 0.0),
        *(0.0, 1.0, 0.0),
        *(0.0, 0.0, 1.0),
    )
    """row-major 3 x 3"""
    offset: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)


class UnusableColors(ValueError):
    """Patches from which no correction follows; the text says what is wrong and what to do."""

    for_people = True


class PatchColor(msgspec.Struct, frozen=True, kw_only=True):
    """The colour of a patch of one surface."""

    mean: tuple[float, float, float]
    """RGB 0..255 (medians of the channels)"""
    spread: tuple[float, float, float]
    """robust standard deviation of each channel"""
    pixels: int
    saturated: float = 0.0
    """share of pixels with a channel at 255 (0..1)"""


class ColorQuality(msgspec.Struct, frozen=True, kw_only=True):
    """How safely the filter of `vantage.perception.scan` tells the corrected colours apart; chromaticity units.

    A margin is the distance to the filter's limit (`COLOR_DISTANCE`), positive = on the right side of it, in the worst case
    of two standard deviations of the patches.
    """

    hider: float
    """the hider's patch is taken for the hider"""
    seeker: float
    grey: float
    """grey is taken for neither"""
    apart: float
    """neither robot is taken for the other"""


def measure_rectangle(picture: Bytes, left: int, top: int, width: int, height: int) -> PatchColor:
    """The colour of a rectangle of a picture uint8 [H, W, 3], px. Raises UnusableColors where it leaves the picture."""
    raise NotImplementedError


def measure_click(picture: Bytes, x: int, y: int, tolerance: float = 0.06) -> PatchColor:
    """The colour of the surface at a pixel: region grown from it while the chromaticity stays within `tolerance`."""
    raise NotImplementedError


def correct_colors(hider: PatchColor, seeker: PatchColor, grey: PatchColor) -> tuple[ColorCorrection, ColorQuality]:
    """The correction that makes the measured colours canonical. Raises UnusableColors (too dark, saturated, alike, uneven)."""
    raise NotImplementedError
