"""Colours of the robots as a camera sees them, and the correction that makes them the canonical ones.

The filter of `vantage.perception.scan` knows two chromaticities, those of HIDER_COLOR and SEEKER_COLOR. A real camera sees
paint, light and its own white balance: from a patch each of the hider, the seeker and something grey follows a 3 x 3 matrix
that makes the three canonical. There is no offset in it: three colours cannot tell a black level from a gain, and without
one every shade of grey stays grey.
"""

from __future__ import annotations

import math
from typing import Annotated, Final

import cv2
import msgspec
import numpy as np
import numpy.typing as npt

from vantage.errors import UserError
from vantage.perception.scan import COLOR_DISTANCE, DARKEST, is_robot_color
from vantage.world.arena import HIDER_COLOR, SEEKER_COLOR

Floats = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]

Finite = Annotated[float, msgspec.Meta(ge=-1e4, le=1e4)]

FEWEST_PIXELS: Final = 30
DARKEST_PATCH: Final = 1.25 * DARKEST
"""Least r + g + b of a patch."""
SATURATED_SHARE: Final = 0.05
"""Greatest share of pixels with a channel at its end."""
UNEVEN_SHARE: Final = 0.25
"""Greatest share of pixels far from the patch's own colour."""
UNEVEN_CHROMATICITY: Final = 0.05
"""Greatest standard deviation of a patch's chromaticity."""
ALIKE: Final = 0.10
"""Least distance between the chromaticities of two patches."""
LEAST_MARGIN: Final = 0.02
REGULARISATION: Final = 0.002
"""Pull of the matrix to a plain white balance, relative to the patches' mean square."""


class ColorCorrection(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """corrected = matrix @ measured + offset, RGB 0..255."""

    matrix: tuple[Finite, Finite, Finite, Finite, Finite, Finite, Finite, Finite, Finite] = (
        *(1.0, 0.0, 0.0),
        *(0.0, 1.0, 0.0),
        *(0.0, 0.0, 1.0),
    )
    """row-major 3 x 3"""
    offset: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)

    def apply(self, colors: npt.ArrayLike) -> Floats:
        """Correct colours [..., 3] -> float64 [..., 3], cut at 0 and 255."""
        matrix = np.array(self.matrix, dtype=np.float64).reshape(3, 3)
        return np.clip(np.asarray(colors, dtype=np.float64) @ matrix.T + np.array(self.offset), 0.0, 255.0)


class UnusableColors(UserError, ValueError):
    """Patches from which no correction follows; the text says what is wrong and what to do."""


class PatchColor(msgspec.Struct, frozen=True, kw_only=True):
    """The colour of a patch of one surface."""

    mean: tuple[float, float, float]
    """RGB 0..255, of the pixels near the median"""
    covariance: tuple[float, float, float, float, float, float]
    """rr, rg, rb, gg, gb, bb of these pixels, smoothed over 3 x 3"""
    pixels: int
    saturated: float = 0.0
    """share of pixels with a channel at 254 or more (0..1)"""
    strange: float = 0.0
    """share of pixels far from the median (0..1)"""


class ColorQuality(msgspec.Struct, frozen=True, kw_only=True):
    """How safely the filter tells the corrected colours apart: distances of chromaticity to its limit, `COLOR_DISTANCE`.

    Positive is the right side, after two standard deviations of the patch's own spread.
    """

    hider: float
    """the hider's patch is taken for the hider"""
    seeker: float
    """the seeker's patch is taken for the seeker"""
    grey: float
    """grey is taken for neither"""
    apart: float
    """neither robot is taken for the other"""

    @property
    def margin(self) -> float:
        """The least of the four; the filter's limit is 0.16."""
        return min(self.hider, self.seeker, self.grey, self.apart)


class LightingLimits(msgspec.Struct, frozen=True, kw_only=True):
    """How far the light may change after the calibration until the filter errs: factors around 1."""

    brightness: tuple[float, float]
    """of all channels together"""
    red: tuple[float, float]
    green: tuple[float, float]
    blue: tuple[float, float]


def measure_rectangle(picture: Bytes, left: int, top: int, width: int, height: int) -> PatchColor:
    """The colour of a rectangle of a picture uint8 [H, W, 3], px. Raises UnusableColors where it leaves the picture."""
    rows, columns = _require_picture(picture)
    if width < 1 or height < 1 or left < 0 or top < 0 or left + width > columns or top + height > rows:
        raise UnusableColors(
            f"the patch {width} x {height} at ({left}, {top}) leaves the picture of {columns} x {rows}; choose it inside"
        )
    patch = picture[top : top + height, left : left + width]
    return _measure(patch.reshape(-1, 3), cv2.blur(np.ascontiguousarray(patch), (3, 3)).reshape(-1, 3))


def grow_region(picture: Bytes, x: int, y: int, tolerance: float = 0.06) -> npt.NDArray[np.bool_]:
    """The surface at a pixel: bool [H, W], the connected pixels whose chromaticity lies within `tolerance` of the pixel's.

    Brightness may vary by a factor of 1.6 either way; a border of 2 px, where surfaces mix, is left off if anything remains
    without it. Raises UnusableColors.
    """
    rows, columns = _require_picture(picture)
    if not (0 <= x < columns and 0 <= y < rows):
        raise UnusableColors(f"the click ({x}, {y}) lies outside the picture of {columns} x {rows}; click inside")
    around = picture[max(0, y - 2) : y + 3, max(0, x - 2) : x + 3].reshape(-1, 3)
    seed = np.median(around, axis=0)
    total = float(seed.sum())
    if total < DARKEST:
        raise UnusableColors(f"the click ({x}, {y}) is too dark (r + g + b = {total:.0f}, needs {DARKEST}); more light, please")
    blurred = cv2.blur(picture, (3, 3)).astype(np.float64)
    sums = blurred.sum(axis=2)
    difference = blurred / np.maximum(sums, 1.0)[..., None] - seed / total
    alike = np.sqrt(np.square(difference).sum(axis=2)) <= tolerance
    alike &= (sums >= total / 1.6) & (sums <= total * 1.6)
    alike[y, x] = True
    _, labels = cv2.connectedComponents(alike.astype(np.uint8), connectivity=4)
    region = labels == labels[y, x]
    inner = cv2.erode(region.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    return inner if np.count_nonzero(inner) >= FEWEST_PIXELS else region


def measure_click(picture: Bytes, x: int, y: int, tolerance: float = 0.06) -> PatchColor:
    """The colour of the surface at a pixel; see `grow_region`."""
    region = grow_region(picture, x, y, tolerance)
    return _measure(picture[region], cv2.blur(picture, (3, 3))[region])


def correct_colors(hider: PatchColor, seeker: PatchColor, grey: PatchColor) -> tuple[ColorCorrection, ColorQuality]:
    """The correction that makes the measured colours canonical, and how safe it is.

    Ridge regression of a 3 x 3 matrix on the three colours, pulled towards the white balance that grey alone gives. The
    brightness of grey is free: it is what the robots' colours leave it. Raises UnusableColors: a patch too dark, saturated,
    uneven, two alike, or the filter's margin below 0.02 after all.
    """
    named = (("hider", hider), ("seeker", seeker), ("grey", grey))
    for name, patch in named:
        _refuse_bad_patch(name, patch)
    for index, (name, patch) in enumerate(named):
        for other_name, other in named[index + 1 :]:
            distance = float(np.linalg.norm(_chromaticity(patch.mean) - _chromaticity(other.mean)))
            if distance < ALIKE:
                raise UnusableColors(
                    f"{name} and {other_name} are too alike (chromaticities {distance:.2f} apart, need {ALIKE:g}); "
                    "choose the patches again, or paint the robots in purer colours"
                )
    measured = np.array([patch.mean for _, patch in named])  # [3, 3], a row each
    balance = float(np.mean(measured[2])) / measured[2]
    robots = measured[:2] * balance
    wanted = np.array([HIDER_COLOR, SEEKER_COLOR], dtype=np.float64)
    brightness = float(np.sum(robots * wanted) / np.sum(robots * robots))
    level = min(max(brightness * float(np.mean(measured[2])), 30.0), 250.0)
    wanted = np.vstack((wanted, np.full(3, level)))
    plain = np.diag(brightness * balance)
    pull = REGULARISATION * float(np.mean(np.square(measured)))
    # Rows of the matrix minimise |measured @ row - wanted|^2 + pull |row - plain|^2.
    matrix = np.linalg.solve(measured.T @ measured + pull * np.eye(3), measured.T @ wanted + pull * plain.T).T
    correction = ColorCorrection(matrix=tuple(map(float, matrix.ravel())))  # type: ignore[arg-type]
    quality = color_quality(correction, hider, seeker, grey)
    if quality.margin < LEAST_MARGIN:
        raise UnusableColors(
            f"the robots' colours cannot be told safely (margin {quality.margin:.3f}, needs {LEAST_MARGIN:g}): the patches are "
            "too alike or too uneven for this camera; use purer colours, more even light or larger patches"
        )
    return correction, quality


def color_quality(correction: ColorCorrection, hider: PatchColor, seeker: PatchColor, grey: PatchColor) -> ColorQuality:
    """How safely the filter tells three patches apart after a correction."""
    targets = (_chromaticity(HIDER_COLOR), _chromaticity(SEEKER_COLOR))
    places, spreads = zip(*(_corrected_chromaticity(correction, patch) for patch in (hider, seeker, grey)), strict=True)

    def distance(patch: int, target: int) -> float:
        return float(np.linalg.norm(places[patch] - targets[target]))

    return ColorQuality(
        hider=COLOR_DISTANCE - distance(0, 0) - 2.0 * spreads[0],
        seeker=COLOR_DISTANCE - distance(1, 1) - 2.0 * spreads[1],
        grey=min(distance(2, 0), distance(2, 1)) - COLOR_DISTANCE - 2.0 * spreads[2],
        apart=min(distance(0, 1) - 2.0 * spreads[0], distance(1, 0) - 2.0 * spreads[1]) - COLOR_DISTANCE,
    )


def lighting_limits(correction: ColorCorrection, hider: PatchColor, seeker: PatchColor, grey: PatchColor) -> LightingLimits:
    """How far the light may change while this correction stays: the measured colours times factors, cut at 255, through the
    correction and the filter itself, in steps of 2 %, from 0.02 to 8."""
    colors = np.array([patch.mean for patch in (hider, seeker, grey)])

    def limit(channels: tuple[int, ...], step: float) -> float:
        factor = 1.0
        while 0.02 < factor * step < 8.0:
            gains = np.ones(3)
            gains[list(channels)] = factor * step
            corrected = np.rint(correction.apply(np.minimum(colors * gains, 255.0))).astype(int).tolist()
            found = [tuple(bool(is_robot_color(*color, robot)) for robot in (0, 1)) for color in corrected]
            if found != [(True, False), (False, True), (False, False)]:
                break
            factor *= step
        return factor

    ranges = [(limit(channels, 1 / 1.02), limit(channels, 1.02)) for channels in ((0, 1, 2), (0,), (1,), (2,))]
    return LightingLimits(brightness=ranges[0], red=ranges[1], green=ranges[2], blue=ranges[3])


def _require_picture(picture: Bytes) -> tuple[int, int]:
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or picture.size == 0:
        raise UnusableColors(f"a colour picture is uint8 [H, W, 3], got {picture.dtype} {list(picture.shape)}")
    return picture.shape[0], picture.shape[1]


def _measure(pixels: Bytes, smoothed: Bytes) -> PatchColor:
    """pixels uint8 [n, 3] and the same of the picture smoothed over 3 x 3: about what a published pixel averages."""
    count = pixels.shape[0]
    if count < FEWEST_PIXELS:
        raise UnusableColors(f"the patch has {count} pixels, needs {FEWEST_PIXELS}: choose a larger one or move closer")
    values = smoothed.astype(np.float64)
    median = np.median(values, axis=0)
    deviation = 1.4826 * np.median(np.abs(values - median), axis=0)
    near = np.all(np.abs(values - median) <= 4.0 * np.maximum(deviation, 2.0), axis=1)
    kept = values[near] if np.count_nonzero(near) >= 2 else values
    covariance = np.cov(kept.T)
    return PatchColor(
        mean=tuple(map(float, kept.mean(axis=0))),  # type: ignore[arg-type]
        covariance=tuple(float(covariance[i, j]) for i in range(3) for j in range(i, 3)),  # type: ignore[arg-type]
        pixels=count,
        saturated=float(np.mean(np.any(pixels >= 254, axis=1))),
        strange=1.0 - float(np.mean(near)),
    )


def _refuse_bad_patch(name: str, patch: PatchColor) -> None:
    total = sum(patch.mean)
    if not math.isfinite(total) or total < DARKEST_PATCH:
        raise UnusableColors(f"the patch of {name} is too dark (r + g + b = {total:.0f}, needs {DARKEST_PATCH:.0f}): more light")
    if patch.saturated > SATURATED_SHARE:
        raise UnusableColors(
            f"the patch of {name} is saturated ({100 * patch.saturated:.0f} % of its pixels at 255): less exposure or light"
        )
    spread = _corrected_chromaticity(ColorCorrection(), patch)[1]
    if patch.strange > UNEVEN_SHARE or spread > UNEVEN_CHROMATICITY:
        raise UnusableColors(
            f"the patch of {name} is too uneven ({100 * patch.strange:.0f} % strange pixels, chromaticity +- {spread:.3f}): "
            "choose a patch on one surface without shine or shadow"
        )


def _chromaticity(color: npt.ArrayLike) -> Floats:
    values = np.asarray(color, dtype=np.float64)
    return values / max(float(values.sum()), 1e-9)


def _corrected_chromaticity(correction: ColorCorrection, patch: PatchColor) -> tuple[Floats, float]:
    """Chromaticity [3] of a corrected patch and its standard deviation, to first order."""
    color = correction.apply(patch.mean)
    total = max(float(color.sum()), 1e-9)
    place = color / total
    rr, rg, rb, gg, gb, bb = patch.covariance
    matrix = np.array(correction.matrix).reshape(3, 3)
    covariance = matrix @ np.array([[rr, rg, rb], [rg, gg, gb], [rb, gb, bb]]) @ matrix.T
    slope = (np.eye(3) - np.outer(place, np.ones(3))) / total
    return place, math.sqrt(max(0.0, float(np.trace(slope @ covariance @ slope.T))))
