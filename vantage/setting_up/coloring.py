"""Measuring the robots' colours in a picture of a robot's colour camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from vantage.setting_up.annotation import ROBOT_COLORS, Canvas
from vantage.setting_up.trouble import TableTrouble
from vantage.tracking.colors import ColorCorrection, PatchColor, grow_region, measure_click, measure_rectangle

Picture = npt.NDArray[np.uint8]
SURFACES: Final = ("hider", "seeker", "grey")
_FRAME: Final = {**ROBOT_COLORS, "grey": (190, 190, 190)}


@dataclass(frozen=True, slots=True)
class Place:
    """Where a surface is in a picture, px: a point (width and height 0) or a rectangle."""

    x: int
    y: int
    width: int = 0
    height: int = 0


def parse_place(surface: str, text: str) -> Place:
    """Read `x,y` or `x,y,width,height`.

    Raises:
        TableTrouble: it is neither.
    """
    try:
        numbers = [int(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 4) or min(numbers) < 0 or (len(numbers) == 4 and min(numbers[2:]) < 1):
        raise TableTrouble(
            f"--{surface} {text!r}: give the place in the picture in pixels, x,y for a point on the surface or x,y,width,height"
        )
    return Place(*numbers)


def measure_colors(picture: Picture, places: dict[str, Place]) -> tuple[dict[str, PatchColor], Picture]:
    """Measure three surfaces.

    Args:
        picture: uint8 [H, W, 3] RGB.
        places: of the surfaces hider, seeker and grey.

    Returns:
        What was measured, and the picture with what was measured outlined.

    Raises:
        TableTrouble: a place lies outside of the picture.
        UnusableColors: nothing can be measured there; the text says why.
    """
    rows, columns = picture.shape[:2]
    canvas = Canvas(picture)
    measured = {}
    for surface in SURFACES:
        place = places[surface]
        if place.x + max(place.width, 1) > columns or place.y + max(place.height, 1) > rows:
            raise TableTrouble(f"--{surface} lies outside of the picture, which has {columns} x {rows} pixels")
        if place.width:
            measured[surface] = measure_rectangle(picture, place.x, place.y, place.width, place.height)
            canvas.rectangle(place.x, place.y, place.width, place.height, _FRAME[surface], surface)
        else:
            measured[surface] = measure_click(picture, place.x, place.y)
            canvas.region(grow_region(picture, place.x, place.y), _FRAME[surface], surface)
    return measured, canvas.picture


def side_by_side(outlined: Picture, picture: Picture, correction: ColorCorrection) -> Picture:
    """Return a picture as measured, with outlines, and beside it as corrected; uint8 [H, 2 W, 3] RGB."""
    shown = []
    for half, label in ((outlined, "as measured"), (np.round(correction.apply(picture)).astype(np.uint8), "corrected")):
        canvas = Canvas(half)
        canvas.words(label, (6.0, 18.0), (255, 255, 255))
        shown.append(canvas.picture)
    return np.concatenate(shown, axis=1)
