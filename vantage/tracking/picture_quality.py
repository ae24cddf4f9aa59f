"""Whether a picture can be read: light, glare, sharpness. Thresholds are in grey levels of 8 bits."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

Picture = npt.NDArray[np.uint8]

DARK_HIGHLIGHT = 45
"""A picture whose brightest twentieth is darker than this is too dark."""
WHITE = 250
OVEREXPOSED_SHARE = 0.15
"""More white than this is too bright; a white sheet under good light stays below 250."""
FLAT = 40
"""Less contrast than this shows no tag."""
SHARP = 0.22
"""Steepest slope over the contrast, per px: an edge blurred by 1.8 px (standard deviation) has this."""
WEAK_MARGIN = 25.0
"""Tags that are read with a smaller margin are about to be lost."""


def light_trouble(picture: Picture) -> str:
    """What is wrong with the light of a whole picture, empty when nothing is; looks at one pixel in 256."""
    sample = picture[::16, ::16]
    if sample.ndim == 3:
        sample = sample.max(axis=2)
    if float(np.percentile(sample, 95)) < DARK_HIGHLIGHT:
        return "overhead picture is too dark: more light, or a longer exposure"
    white = float((sample >= WHITE).mean())
    if white > OVEREXPOSED_SHARE:
        return f"overhead picture is overexposed ({100 * white:.0f} % white): less light, or a shorter exposure"
    return ""


def why_unseen(grey: Picture) -> str:
    """Why there may be no tag to be seen in a grey window, uint8 [h, w]; empty when it looks fine."""
    if grey.size == 0:
        return "its place is outside the picture"
    white = float((grey >= WHITE).mean())
    if white > OVEREXPOSED_SHARE:
        return f"glare: {100 * white:.0f} % of its surroundings are white"
    low, high = (float(level) for level in np.percentile(grey, (3, 97)))
    if high < DARK_HIGHLIGHT:
        return "too dark"
    if high - low < FLAT:
        return "covered, or no contrast"
    smooth = cv2.GaussianBlur(grey, (0, 0), 0.7)
    slopes = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)) / 8.0
    if float(np.percentile(slopes, 99)) < SHARP * (high - low):
        return "blurred: focus the lens, shorten the exposure"
    return ""
