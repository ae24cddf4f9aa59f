"""The colours of the state image, one table of palette indices (paper, State Representation; reading, row 7), and of danger."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from schemas import STATE_IMAGE_SIZE, Robot
from vantage.world.arena import ARENA_SIZE, HIDER_COLOR, ROBOT_COLORS, SEEKER_COLOR

INVISIBLE = 0
FREE = 1
BOUNDARY = 2
OWN = 3
OTHER = 4

PIXEL_SIZE = ARENA_SIZE / STATE_IMAGE_SIZE
"""Metres a pixel of a state image or an action map."""

PALETTE: NDArray[np.uint8] = np.array(  # [5, 3]
    [
        (0, 0, 255),  # invisible: the paper's blue
        (255, 255, 255),  # visible free
        (0, 0, 0),  # obstacle boundary
        (0, 255, 0),  # own disc
        (255, 0, 0),  # other's disc
    ],
    dtype=np.uint8,
)
"""RGB of each palette index; corners of the colour cube, so that a mean squared error keeps the classes far apart."""
PALETTE.setflags(write=False)

PALETTE_NAMES = ("invisible", "free", "boundary", "own", "other")
"""What each palette index means, in a word."""

DANGER: NDArray[np.uint8] = np.array(  # [7, 3]
    [(69, 117, 180), (145, 191, 219), (224, 243, 248), (255, 255, 191), (254, 224, 144), (252, 141, 89), (215, 48, 39)], np.uint8
)
"""Colours of a value map from safe to dangerous: Brewer's RdYlBu in seven classes, as on the console's page and in figures."""
DANGER.setflags(write=False)


def view_palette(robot: Robot) -> NDArray[np.uint8]:
    """Return RGB of each palette index of a robot's state images as people see them, uint8 [5, 3].

    A robot has one colour whoever looks. Networks get `PALETTE` instead, which knows only "own" and "other".
    """
    palette = PALETTE.copy()
    palette[OWN] = ROBOT_COLORS[robot]
    palette[OTHER] = ROBOT_COLORS["seeker" if robot == "hider" else "hider"]
    return palette


def view_for_people(view: NDArray[np.uint8], robot: Robot) -> NDArray[np.uint8]:
    """Return a robot's state image in a network's colours, drawn or predicted, as people see it: uint8 [..., 3] -> [..., 3].

    What has a colour of `PALETTE` gets the one of `view_palette`; what a prediction blurs is blended in between.
    """
    red, green, blue = np.moveaxis(view.astype(np.float32) / 255, -1, 0)
    if robot == "seeker":
        red, green = green, red  # its own disc is green to the networks
    colors = 255 * np.stack((red, green, blue), axis=-1)
    for share, pure, shown in (
        (green * (1 - red) * (1 - blue), (0, 255, 0), HIDER_COLOR),
        (red * (1 - green) * (1 - blue), (255, 0, 0), SEEKER_COLOR),
    ):
        colors += share[..., None] * (np.array(shown, np.float32) - np.array(pure, np.float32))
    return colors.round().clip(0, 255).astype(np.uint8)


def to_rgb(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Colours of a state image: uint8 [..., 128, 128] palette indices -> uint8 [..., 128, 128, 3] RGB."""
    return PALETTE[image]


def from_rgb(colors: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Nearest palette index of each RGB colour (a predicted view): [..., 3] in 0..255 -> uint8 [...]."""
    difference = np.asarray(colors, dtype=np.float32)[..., None, :] - PALETTE.astype(np.float32)
    return np.argmin(np.square(difference).sum(axis=-1), axis=-1).astype(np.uint8)
