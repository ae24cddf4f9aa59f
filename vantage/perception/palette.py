"""The colours of the state image, one table of palette indices (paper, State Representation; reading, row 7), and of danger."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from schemas import STATE_IMAGE_SIZE
from vantage.world.arena import ARENA_SIZE

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


def to_rgb(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Colours of a state image: uint8 [..., 128, 128] palette indices -> uint8 [..., 128, 128, 3] RGB."""
    return PALETTE[image]


def from_rgb(colors: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Nearest palette index of each RGB colour (a predicted view): [..., 3] in 0..255 -> uint8 [...]."""
    difference = np.asarray(colors, dtype=np.float32)[..., None, :] - PALETTE.astype(np.float32)
    return np.argmin(np.square(difference).sum(axis=-1), axis=-1).astype(np.uint8)
