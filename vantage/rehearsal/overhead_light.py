"""What light, lens blur and sensor noise make of a rendered picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from vantage.world.arena import WALL_HEIGHT

Picture = npt.NDArray[np.uint8]

_NOISE_MARGIN = 128


@dataclass(frozen=True)
class OverheadLook:
    """How light and camera treat the picture."""

    blur: float = 0.8
    """standard deviation of the lens's blur, px"""
    noise: float = 3.0
    """standard deviation, grey levels"""
    exposure: float = 0.006
    """s; robots smear along their way meanwhile"""
    brightness: float = 0.9
    """of the light in the middle"""
    gradient: float = 0.25
    """brightness gained from the left edge to the right one, as a share"""
    vignette: float = 0.25
    """brightness lost from the middle to the corners, as a share"""
    glare_column: float = 0.0
    """middle of a reflected lamp, px"""
    glare_row: float = 0.0
    """middle of a reflected lamp, px"""
    glare_radius: float = 0.0
    """of a reflected lamp, px; 0 = none"""
    wall_height: float = WALL_HEIGHT
    """m; 0 = no walls"""

    @property
    def blur_reach(self) -> int:
        """How far the lens's blur carries light, px (half of OpenCV's kernel, rounded up)."""
        return math.ceil(4 * self.blur) + 1


class Development:
    """Turns sharp, evenly lit pictures of one size into what a camera gives.

    Args:
        width: px.
        height: px.
        look: light and camera.
    """

    def __init__(self, width: int, height: int, look: OverheadLook) -> None:
        self.width, self.height, self._look = width, height, look
        self._gain, self._veil = self._light()
        self._noise: dict[int, npt.NDArray[np.int16]] = {}

    def develop(self, patch: npt.NDArray[np.float32], window: tuple[int, int, int, int], light: npt.NDArray[np.int16]) -> None:
        """Blur and light a patch float32 [h, w, 3] and put it into its window of light int16 [H, W, 3], sixteenths."""
        left, top, right, bottom = window
        if self._look.blur > 0:
            patch = cv2.GaussianBlur(patch, (0, 0), self._look.blur, borderType=cv2.BORDER_REPLICATE)
        # The blur at the patch's rim lacks its surroundings: the rim stays as it was, but for the picture's own edges.
        rim = self._look.blur_reach
        low = (0 if top == 0 else rim, 0 if left == 0 else rim)
        high = (bottom - top - (0 if bottom == self.height else rim), right - left - (0 if right == self.width else rim))
        inner = (slice(low[0], high[0]), slice(low[1], high[1]))
        place = (slice(top + low[0], top + high[0]), slice(left + low[1], left + high[1]))
        light[place] = np.clip((patch[inner] * self._gain[place] + self._veil[place]) * 16 + 0.5, 0, 32000)

    def read_out(self, light: npt.NDArray[np.int16], seed: int, frame: int) -> Picture:
        height, width = light.shape[:2]
        bank = self._noise.get(seed)
        if bank is None:
            random = np.random.default_rng(seed)
            size = (height + _NOISE_MARGIN, (width + _NOISE_MARGIN) * 3)
            bank = (random.standard_normal(size, dtype=np.float32) * (16 * self._look.noise)).astype(np.int16)
            self._noise = {seed: bank}
        # Every frame cuts its noise out of one large field, elsewhere.
        down, right = np.random.default_rng((seed, frame)).integers(0, _NOISE_MARGIN, 2)
        noise = bank[down : down + height, 3 * right : 3 * (right + width)]
        # Sixteenths of a grey level, rounded and held within 0 to 255.
        picture = cv2.addWeighted(light.reshape(height, width * 3), 1 / 16, noise, 1 / 16, 0.0, dtype=cv2.CV_8U)
        return np.asarray(picture.reshape(height, width, 3))

    def _light(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Gain and veil of every pixel, float32 [H, W, 1]."""
        width, height = self.width, self.height
        across, down = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
        slope = (across * 0.9 + down * 0.4) * self._look.gradient / 2
        gain = self._look.brightness * (1 + slope) * (1 - self._look.vignette * (across**2 + down**2) / 2)
        veil = np.zeros_like(gain)
        if self._look.glare_radius > 0:
            u, v = np.meshgrid(np.arange(width), np.arange(height))
            away = np.hypot(u - self._look.glare_column, v - self._look.glare_row) / self._look.glare_radius
            veil = 400.0 * np.exp(-(away**4))
        return gain[..., None].astype(np.float32), veil[..., None].astype(np.float32)
