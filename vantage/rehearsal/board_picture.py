"""A camera's pictures of a ChArUco board held before it, for rehearsing the lens calibration."""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from vantage.compiled import kernel
from vantage.rehearsal.overhead_light import Development, OverheadLook
from vantage.tracking.lens import BoardDescription, Lens, charuco_board

Floats = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

_TEXELS = 40
"""Of the board's drawing, a square's side."""
_SAMPLES = 4
"""Of a pixel, each way."""
_SURROUNDINGS = 96.0
_MARGIN = 0.4
"""White sheet around the board, as a share of a square."""


@kernel
def _expose_board(
    slopes: Floats, plane: Floats, drawing: Picture, texel: float, margin: float, out: npt.NDArray[np.float32]
) -> None:
    """Render the board, sharp, into out float32 [H, W, 3].

    slopes float64 [H + 1, W + 1, 2] of the rays through the pixels' corners; plane float64 [3, 3] maps ray slopes to the
    board's plane, m; drawing uint8 [h, w], whose texels are `texel` m wide; margin in m.
    """
    rows, columns = drawing.shape
    for v in range(out.shape[0]):
        for u in range(out.shape[1]):
            total = 0.0
            for i in range(_SAMPLES):
                down = (i + 0.5) / _SAMPLES
                for j in range(_SAMPLES):
                    right = (j + 0.5) / _SAMPLES
                    a, b = 0.0, 0.0
                    for di in range(2):
                        for dj in range(2):
                            weight = (down if di else 1 - down) * (right if dj else 1 - right)
                            a += weight * slopes[v + di, u + dj, 0]
                            b += weight * slopes[v + di, u + dj, 1]
                    depth = plane[2, 0] * a + plane[2, 1] * b + plane[2, 2]
                    x = (plane[0, 0] * a + plane[0, 1] * b + plane[0, 2]) / depth
                    y = (plane[1, 0] * a + plane[1, 1] * b + plane[1, 2]) / depth
                    column, row = math.floor(x / texel), math.floor(y / texel)
                    if 0 <= row < rows and 0 <= column < columns:
                        total += drawing[row, column]
                    elif -margin <= x <= columns * texel + margin and -margin <= y <= rows * texel + margin:
                        total += 255.0
                    else:
                        total += _SURROUNDINGS
            for channel in range(3):
                out[v, u, channel] = 20.0 + 0.82 * total / _SAMPLES**2


class BoardScene:
    """A ChArUco board before a camera.

    Args:
        lens: the true lens.
        board: default that of `vantage table print`.
        look: light and camera.
    """

    def __init__(self, lens: Lens, board: BoardDescription | None = None, look: OverheadLook | None = None) -> None:
        self.board = board or BoardDescription()
        self._development = Development(lens.width, lens.height, look or OverheadLook())
        size = (self.board.columns * _TEXELS, self.board.rows * _TEXELS)
        self._drawing = np.ascontiguousarray(charuco_board(self.board).generateImage(size, marginSize=0, borderBits=1))
        u, v = np.meshgrid(np.arange(lens.width + 1) - 0.5, np.arange(lens.height + 1) - 0.5)
        pixels = np.stack((u, v), axis=-1).reshape(-1, 1, 2)
        slopes = cv2.undistortPoints(pixels, np.array(lens.matrix).reshape(3, 3), np.array(lens.distortion))
        self._slopes = np.ascontiguousarray(np.asarray(slopes, np.float64).reshape(lens.height + 1, lens.width + 1, 2))

    def render(self, rotation: Floats, translation: Floats, seed: int, frame: int) -> Picture:
        """Take a picture: uint8 [H, W, 3] RGB.

        Args:
            rotation: float64 [3], rotation vector from the board's axes (x along columns, y along rows, z away from who
                looks at it) to the camera's.
            translation: of the board's first corner, float64 [3] m in the camera's axes.
            seed: of the noise.
            frame: number of the picture.
        """
        turn = cv2.Rodrigues(np.asarray(rotation, np.float64))[0]
        plane = np.linalg.inv(np.column_stack((turn[:, 0], turn[:, 1], translation)))
        sharp = np.empty((self._development.height, self._development.width, 3), np.float32)
        texel = self.board.square / _TEXELS
        _expose_board(self._slopes, plane, self._drawing, texel, _MARGIN * self.board.square, sharp)
        light = np.empty(sharp.shape, np.int16)
        self._development.develop(sharp, (0, 0, self._development.width, self._development.height), light)
        return self._development.read_out(light, seed, frame)


def draw_views(
    count: int, board: BoardDescription, seed: int, distance: tuple[float, float] = (0.35, 0.6)
) -> list[tuple[Floats, Floats]]:
    """Draw places of the board as a person would hold it: rotation vectors and translations, tilted up to about 35 degrees."""
    random = np.random.default_rng(seed)
    views = []
    middle = np.array([board.columns, board.rows, 0.0]) * board.square / 2
    for _ in range(count):
        tilt = random.uniform(-0.6, 0.6, 2)
        rotation = cv2.Rodrigues(np.array([tilt[0], tilt[1], random.uniform(-0.3, 0.3)]))[0]
        away = random.uniform(*distance)
        aim = np.array([random.uniform(-0.4, 0.4), random.uniform(-0.22, 0.22), 1.0]) * away
        views.append((cv2.Rodrigues(rotation)[0].ravel(), aim - rotation @ middle))
    return views
