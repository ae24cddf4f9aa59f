"""Pictures of the ChArUco board before the rehearsed overhead camera, as somebody who measures its lens would take them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np
import numpy.typing as npt

from vantage.tracking.calibration import Calibration
from vantage.tracking.lens import BoardDescription, charuco_board

Picture = npt.NDArray[np.uint8]

PIXELS_PER_SQUARE = 80
_DISTANCES = (0.28, 0.34, 0.42)
"""m from the lens, in turn."""
_TILTS = (0.0, 0.35, -0.35, 0.55, -0.55)
"""rad about the board's two axes, in turn."""


def board_pictures(camera: Calibration, board: BoardDescription, count: int, seed: int) -> Iterator[Picture]:
    """Yield pictures uint8 [H, W] of the board held all over the picture, near and far, tilted this way and that."""
    generator = np.random.default_rng(seed)
    printed = charuco_board(board).generateImage(
        (board.columns * PIXELS_PER_SQUARE, board.rows * PIXELS_PER_SQUARE), marginSize=0, borderBits=1
    )
    width, height = camera.width, camera.height
    matrix = np.array(camera.matrix).reshape(3, 3)
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    pixels = np.stack((u, v), axis=-1).reshape(-1, 1, 2)
    rays = cv2.undistortPoints(pixels, matrix, np.array(camera.distortion)).reshape(-1, 2)
    rays = np.concatenate((rays, np.ones((len(rays), 1))), axis=1)  # [H W, 3]
    for number in range(count):
        distance = _DISTANCES[number % len(_DISTANCES)]
        angles = (_TILTS[number % len(_TILTS)], _TILTS[(number // 2) % len(_TILTS)], 0.2 * generator.standard_normal())
        rotation = cv2.Rodrigues(np.array(angles))[0]
        # Somewhere in the picture, so that over all pictures its corners are covered, too.
        place = np.array([(0.22 + 0.56 * generator.random()) * width, (0.22 + 0.56 * generator.random()) * height])
        middle = np.array([(place[0] - matrix[0, 2]) / matrix[0, 0], (place[1] - matrix[1, 2]) / matrix[1, 1], 1.0]) * distance
        normal = rotation[:, 2]
        points = rays * (middle @ normal / (rays @ normal))[:, None] - middle  # on the board's plane
        across = (points @ rotation[:, 0] / board.square + board.columns / 2) * PIXELS_PER_SQUARE - 0.5
        down = (points @ rotation[:, 1] / board.square + board.rows / 2) * PIXELS_PER_SQUARE - 0.5
        columns, rows = (part.reshape(height, width).astype(np.float32) for part in (across, down))
        seen = cv2.remap(printed, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=230.0)
        seen = cv2.GaussianBlur(seen, (0, 0), 0.8) * (0.75 + 0.1 * math.sin(number)) + 3.0 * generator.standard_normal(seen.shape)
        yield np.clip(seen, 0, 255).astype(np.uint8)
