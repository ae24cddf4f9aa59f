"""The action maps F (visitation) and T (time) of a planned path, and the eight symmetries of the square.

F and T are luminance + alpha, alpha 0 where the path never comes, darker = more visits / later (paper, Action
Embedding; reading, row 9). Both scales are absolute over `SCALE_STEPS` steps, never per image, or the horizon is erased:

* F: a position paints a disc of 21 pixels (5 x 5 without corners, 2.5 pixels or 23 mm of radius). With n positions painted over a
  pixel, waiting and turning included, luminance = 255 (1 - log(1 + n) / log(401)): one position 226, a drive past (about
  five positions) 179, 300 waits 12, saturated from 400 on.
* T: luminance = 255 (1 - t / 400) with t the steps since the path's `start` at the latest visit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from schemas import STATE_IMAGE_SIZE
from vantage.compiled import kernel
from vantage.perception.palette import PIXEL_SIZE
from vantage.world.arena import ARENA_SIZE

SCALE_STEPS = 400
"""Steps at which F and T are darkest."""

_SIZE = STATE_IMAGE_SIZE
_STEPS = np.arange(SCALE_STEPS + 1)
_FREQUENCY = np.round(255.0 * (1.0 - np.log1p(_STEPS) / np.log1p(SCALE_STEPS))).astype(np.uint8)
_TIME = np.round(255.0 * (1.0 - _STEPS / SCALE_STEPS)).astype(np.uint8)


@kernel
def _pixel(x: float, y: float) -> tuple[int, int]:
    """Column and row of a position in m, drawn at the edge where it lies outside; (-1, -1) where it is not finite."""
    if not (math.isfinite(x) and math.isfinite(y)):
        return -1, -1
    column = min(_SIZE - 1.0, max(0.0, math.floor(x / PIXEL_SIZE)))
    row = min(_SIZE - 1.0, max(0.0, math.floor((ARENA_SIZE - y) / PIXEL_SIZE)))
    return int(column), int(row)


@kernel
def extend_action_maps(
    path: NDArray[np.floating],  # [S, 2 or more]
    start: int,
    first: int,
    stop: int,
    counts: NDArray[np.uint16],  # [128, 128]
    frequency: NDArray[np.uint8],  # [128, 128] luminance of F
    frequency_alpha: NDArray[np.uint8],  # [128, 128]
    time: NDArray[np.uint8],  # [128, 128] luminance of T
    time_alpha: NDArray[np.uint8],  # [128, 128]
) -> None:
    """Adds positions first .. stop (both included) of a path that began at `start` to its maps.

    Maps and `counts` must hold positions start .. first - 1, all zero where first = start; so the maps of many horizons of one
    path cost no more than those of the longest. Positions in m, arena frame; those outside it are drawn at its edge, those
    not finite nowhere. Raises ValueError unless 0 <= start <= first and stop < S.
    """
    if start < 0 or first < start or stop >= path.shape[0]:
        raise ValueError("action maps need 0 <= start <= first and stop below the number of positions")
    step = first
    while step <= stop:
        column, row = _pixel(path[step, 0], path[step, 1])
        run = 1  # waiting and turning: positions on the same pixel are painted at once
        while step + run <= stop:
            next_column, next_row = _pixel(path[step + run, 0], path[step + run, 1])
            if next_column != column or next_row != row:
                break
            run += 1
        step += run
        if column < 0:
            continue
        shade = _TIME[min(SCALE_STEPS, step - 1 - start)]
        for across in range(-2, 3):
            r = row + across
            if not 0 <= r < _SIZE:
                continue
            half = 1 if across == -2 or across == 2 else 2
            for c in range(max(0, column - half), min(_SIZE, column + half + 1)):
                count = np.int64(counts[r, c]) + run
                if count > SCALE_STEPS:
                    count = np.int64(SCALE_STEPS)
                counts[r, c] = count
                frequency[r, c] = _FREQUENCY[count]
            for c in range(max(0, column - half), min(_SIZE, column + half + 1)):
                frequency_alpha[r, c] = 255
                time[r, c] = shade
                time_alpha[r, c] = 255


@kernel
def draw_action_maps(
    path: NDArray[np.floating],  # [S, 2 or more]
    start: int,
    stop: int,
    frequency_out: NDArray[np.uint8],  # [128, 128, 2]
    time_out: NDArray[np.uint8],  # [128, 128, 2]
) -> None:
    """Draws F and T, luminance + alpha each, of positions start .. stop (both included) of a path in m."""
    frequency_out[:] = 0
    time_out[:] = 0
    counts = np.zeros((_SIZE, _SIZE), np.uint16)
    extend_action_maps(
        path, start, start, stop, counts, frequency_out[:, :, 0], frequency_out[:, :, 1], time_out[:, :, 0], time_out[:, :, 1]
    )


@kernel
def draw_batch(
    paths: NDArray[np.floating],  # [B, S, 2 or more]
    starts: NDArray[np.integer],  # [B]
    stops: NDArray[np.integer],  # [B]
    out: NDArray[np.uint8],  # [B, 4, 128, 128]
) -> None:
    """Draws the action maps of positions starts[b] .. stops[b] of each path: F luminance, F alpha, T luminance, T alpha."""
    counts = np.empty((_SIZE, _SIZE), np.uint16)
    for b in range(paths.shape[0]):
        counts[:] = 0
        out[b] = 0
        extend_action_maps(paths[b], starts[b], starts[b], stops[b], counts, out[b, 0], out[b, 1], out[b, 2], out[b, 3])


@kernel
def draw_horizons(
    path: NDArray[np.floating],  # [S, 2 or more]
    start: int,
    stops: NDArray[np.integer],  # [K], ascending
    out: NDArray[np.uint8],  # [K, 4, 128, 128]
) -> None:
    """Draws the action maps of one path at several horizons: out[k] holds positions start .. stops[k], as `draw_batch`.

    Each is the one before, copied and extended. Raises ValueError where `stops` descend.
    """
    counts = np.zeros((_SIZE, _SIZE), np.uint16)
    first = start
    for k in range(stops.shape[0]):
        if stops[k] < first - 1:
            raise ValueError("horizons must be in ascending order")
        if k == 0:
            out[0] = 0
        else:
            out[k] = out[k - 1]
        extend_action_maps(path, start, first, stops[k], counts, out[k, 0], out[k, 1], out[k, 2], out[k, 3])
        first = stops[k] + 1


@kernel
def transform_image(image: NDArray[np.uint8], k: int, out: NDArray[np.uint8]) -> None:
    """Applies symmetry k (0..7) of the square to a [128, 128] image: for k >= 4 mirrored left to right first, then turned
    k % 4 times a quarter counter-clockwise. `out` must not be `image`. Raises ValueError for another k."""
    if k < 0 or k > 7:
        raise ValueError("there are eight symmetries of the square: k must be 0 to 7")
    last = image.shape[0] - 1
    turns = k % 4
    for row in range(last + 1):
        for column in range(last + 1):
            if turns == 0:
                source_row, source_column = row, column
            elif turns == 1:
                source_row, source_column = column, last - row
            elif turns == 2:
                source_row, source_column = last - row, last - column
            else:
                source_row, source_column = last - column, row
            if k >= 4:
                source_column = last - source_column
            out[row, column] = image[source_row, source_column]


def transform_path(path: NDArray[np.floating], k: int) -> NDArray[np.floating]:
    """The same symmetry as `transform_image` applied to positions (m) about the arena's centre.

    `path` [..., 2] x, y or [..., 3] x, y, heading (rad; the new one lies in [-pi, pi]). Returns a new array of its dtype.
    Raises ValueError for a k outside 0..7.
    """
    if not 0 <= k <= 7:
        raise ValueError(f"there are eight symmetries of the square: k must be 0 to 7, got {k}")
    out = np.array(path)
    if k >= 4:
        out[..., 0] = ARENA_SIZE - out[..., 0]
    for _ in range(k % 4):
        x = out[..., 0].copy()
        out[..., 0] = ARENA_SIZE - out[..., 1]
        out[..., 1] = x
    if out.shape[-1] > 2:
        heading = (math.pi - out[..., 2] if k >= 4 else out[..., 2]) + 0.5 * math.pi * (k % 4)
        out[..., 2] = np.arctan2(np.sin(heading), np.cos(heading))
    return out
