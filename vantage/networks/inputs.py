"""What VPT-TOB is shown: state image and planned path -> seven channels. One code path for training and for play.

Channels, uint8: red, green, blue of the state image; F luminance, alpha; T luminance, alpha. Pixels before channels, so that
`torch.from_numpy(inputs).permute(0, 3, 1, 2)` is a channels-last tensor without a copy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from schemas import STATE_IMAGE_SIZE
from vantage.compiled import kernel
from vantage.perception.action_maps import extend_action_maps
from vantage.perception.palette import PALETTE

CHANNELS = 7

_SIZE = STATE_IMAGE_SIZE
_COLORS = np.array(PALETTE)  # uint8 [5, 3]


def _symmetry_sources() -> NDArray[np.int32]:
    pixels = np.arange(_SIZE * _SIZE, dtype=np.int32).reshape(_SIZE, _SIZE)
    return np.stack([np.rot90(pixels[:, ::-1] if k >= 4 else pixels, k % 4).ravel() for k in range(8)])


_SOURCES = _symmetry_sources()  # int32 [8, 128 * 128]: pixel p of symmetry k comes from pixel _SOURCES[k, p]


@kernel
def render_inputs(
    views: NDArray[np.uint8],  # [V, 128, 128] palette indices
    view_of: NDArray[np.int64],  # [B] row of `views`
    positions: NDArray[np.floating],  # [N, 2 or more] x, y in m, one path after the other
    first: NDArray[np.int64],  # [B] row of `positions` at step 0
    horizons: NDArray[np.int64],  # [B] steps: the path is drawn from step 0 to this one, both included
    symmetries: NDArray[np.int64],  # [B] 0..7, as `transform_image`
    out: NDArray[np.uint8],  # [B, 128, 128, 7]
) -> None:
    """Render B inputs of VPT-TOB. Raises ValueError where a path ends before its horizon."""
    maps = np.empty((4, _SIZE, _SIZE), np.uint8)
    flat = maps.reshape(4, _SIZE * _SIZE)
    counts = np.empty((_SIZE, _SIZE), np.uint16)
    for b in range(view_of.shape[0]):
        maps[:] = 0
        counts[:] = 0
        start = first[b]
        extend_action_maps(positions, start, start, start + horizons[b], counts, maps[0], maps[1], maps[2], maps[3])
        view = views[view_of[b]].reshape(_SIZE * _SIZE)
        pixels = out[b].reshape(_SIZE * _SIZE, 7)
        sources = _SOURCES[symmetries[b]]
        for p in range(_SIZE * _SIZE):
            source = sources[p]
            color = _COLORS[view[source]]
            pixels[p, 0] = color[0]
            pixels[p, 1] = color[1]
            pixels[p, 2] = color[2]
            pixels[p, 3] = flat[0, source]
            pixels[p, 4] = flat[1, source]
            pixels[p, 5] = flat[2, source]
            pixels[p, 6] = flat[3, source]


@kernel
def render_targets(
    views: NDArray[np.uint8],  # [B, 128, 128] palette indices
    symmetries: NDArray[np.int64],  # [B]
    out: NDArray[np.uint8],  # [B, 128, 128, 3] red, green, blue
    discs_out: NDArray[np.bool_],  # [B, 128, 128] where a robot's disc is
) -> None:
    """Render B seeker views as VPT-TOB is to predict them."""
    for b in range(views.shape[0]):
        view = views[b].reshape(_SIZE * _SIZE)
        pixels = out[b].reshape(_SIZE * _SIZE, 3)
        discs = discs_out[b].reshape(_SIZE * _SIZE)
        sources = _SOURCES[symmetries[b]]
        for p in range(_SIZE * _SIZE):
            index = view[sources[p]]
            color = _COLORS[index]
            pixels[p, 0] = color[0]
            pixels[p, 1] = color[1]
            pixels[p, 2] = color[2]
            discs[p] = index >= 3
