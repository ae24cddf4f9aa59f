"""Compiled steps of `rgbd.RgbdPreparer`: projection of every depth pixel, and gathering into the published pixels."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vantage.compiled import kernel

Floats32 = npt.NDArray[np.float32]
Integers32 = npt.NDArray[np.int32]
Depths = npt.NDArray[np.uint16]
Bytes = npt.NDArray[np.uint8]

BLOCK = 4
"""px: side of the blocks of colour pixels whose nearest depth decides what hides what from the colour lens. One pixel would not
do: where the colour lens sees a surface at a wider angle than the depth lens, its samples lie apart and what is behind shows."""
HIDDEN = 0.04
"""m behind the nearest of its block from which a point counts as hidden from the colour lens."""
_NEAREST = 1e-3


@kernel
def find_places(
    depth: Depths,  # [H, W]
    unit: float,
    nearest: float,
    slopes: Floats32,  # [H, 2, W]: x / z and y / z of what each depth pixel looks at
    to_level: Floats32,  # [3, 4]: rotation and, m, translation from the depth lens's frame to the level frame
    pinhole: npt.NDArray[np.float64],  # [4]: fx, fy, cx, cy of the published picture, px
    rows_out: int,
    columns_out: int,
    to_color: Floats32,  # [3, 4]: the same to the frame of the colour lens
    lens: npt.NDArray[np.float64],  # [4]: fx, fy, cx, cy of the colour lens, px
    distortion: npt.NDArray[np.float64],  # [5]
    is_distorted: bool,
    largest_square: float,
    color_rows: int,
    color_columns: int,
    color_every: int,
    cells_out: Integers32,  # [H, W]
    depths_out: Floats32,  # [H, W]
    places_out: Integers32,  # [H, W]
    color_depths_out: Floats32,  # [H, W]
    nearest_out: Floats32,  # [color_rows / BLOCK, color_columns / BLOCK], rounded up
    starts_out: Integers32,  # [cells + 1]
) -> None:
    """Where each depth pixel lies in the published picture and in the colour picture.

    `cells_out`: published pixel, -1 = none; `depths_out`: depth along the level axis, m. `places_out`: colour pixel, -1 = none
    or not asked (`color_every` 2 asks every second pixel, as on a chessboard); `color_depths_out`: depth along the colour
    lens's axis, m; `nearest_out`: the least of it in each block of colour pixels. `starts_out[cell + 1]`: pixels in the cell.
    `largest_square`: beyond this x^2 + y^2 the distortion is not trusted.
    """
    rows, columns = depth.shape
    for block_v in range(nearest_out.shape[0]):
        for block_u in range(nearest_out.shape[1]):
            nearest_out[block_v, block_u] = np.float32(np.inf)
    for cell in range(starts_out.shape[0]):
        starts_out[cell] = 0
    lowest = max(1, int(np.ceil(nearest / unit - 1e-9)))
    across = np.empty(columns, np.float32)
    down = np.empty(columns, np.float32)
    axial = np.empty(columns, np.float32)
    for v in range(rows):
        # A row at a time, arithmetic and decisions apart: the former then runs in vector instructions.
        _project_row(depth[v], unit, slopes[v], to_color, distortion, is_distorted, largest_square, across, down, axial)
        _to_pixels(across, down, lens)
        _find_color(
            v & 1 if color_every == 2 else 0,
            color_every,
            depth[v],
            lowest,
            across,
            down,
            axial,
            color_rows,
            color_columns,
            places_out[v],
            color_depths_out[v],
            nearest_out,
        )
        _project_row(depth[v], unit, slopes[v], to_level, distortion, False, np.inf, across, down, axial)
        _to_pixels(across, down, pinhole)
        _find_cells(depth[v], lowest, across, down, axial, rows_out, columns_out, cells_out[v], depths_out[v], starts_out)


@kernel
def _find_color(
    first: int,
    every: int,
    depth: Depths,  # [W]
    lowest: int,
    across: Floats32,  # [W]
    down: Floats32,  # [W]
    axial: Floats32,  # [W]
    rows: int,
    columns: int,
    places_out: Integers32,  # [W]
    color_depths_out: Floats32,  # [W]
    nearest_out: Floats32,  # [blocks, blocks]
) -> None:
    for u in range(first, depth.shape[0], every):
        place = np.int32(-1)
        if depth[u] >= lowest and axial[u] > _NEAREST and 0.0 <= across[u] < columns and 0.0 <= down[u] < rows:
            column = np.uint32(across[u])
            row = np.uint32(down[u])
            place = np.int32(row * columns + column)
            color_depths_out[u] = axial[u]
            if axial[u] < nearest_out[row // BLOCK, column // BLOCK]:
                nearest_out[row // BLOCK, column // BLOCK] = axial[u]
        places_out[u] = place


@kernel
def _find_cells(
    depth: Depths,  # [W]
    lowest: int,
    across: Floats32,  # [W]
    down: Floats32,  # [W]
    axial: Floats32,  # [W]
    rows: int,
    columns: int,
    cells_out: Integers32,  # [W]
    depths_out: Floats32,  # [W]
    starts_out: Integers32,  # [cells + 1]
) -> None:
    for u in range(depth.shape[0]):
        cell = np.int32(-1)
        if depth[u] >= lowest and axial[u] > _NEAREST and 0.0 <= across[u] < columns and 0.0 <= down[u] < rows:
            cell = np.int32(np.uint32(down[u]) * columns + np.uint32(across[u]))
            starts_out[np.uint32(cell + 1)] += 1
        cells_out[u] = cell
        depths_out[u] = axial[u]


@kernel
def _project_row(
    depth: Depths,  # [W]
    unit: float,
    slopes: Floats32,  # [2, W]
    motion: Floats32,  # [3, 4]
    distortion: npt.NDArray[np.float64],  # [5]
    is_distorted: bool,
    largest_square: float,
    x_out: Floats32,  # [W]
    y_out: Floats32,  # [W]
    axial_out: Floats32,  # [W]
) -> None:
    """Slopes (distorted) and depth along the axis of a row of depth pixels before a lens; NaN beyond `largest_square`."""
    scale = np.float32(unit)
    one = np.float32(1.0)
    xx, xy, xz, shift_x = motion[0, 0], motion[0, 1], motion[0, 2], motion[0, 3]
    yx, yy, yz, shift_y = motion[1, 0], motion[1, 1], motion[1, 2], motion[1, 3]
    zx, zy, zz, shift_z = motion[2, 0], motion[2, 1], motion[2, 2], motion[2, 3]
    for u in range(depth.shape[0]):
        z = scale * np.float32(depth[u])
        right = slopes[0, u]
        below = slopes[1, u]
        axial = z * (zx * right + zy * below + zz) + shift_z
        inverse = one / axial
        axial_out[u] = axial
        x_out[u] = (z * (xx * right + xy * below + xz) + shift_x) * inverse
        y_out[u] = (z * (yx * right + yy * below + yz) + shift_y) * inverse
    if not is_distorted:
        return
    k1, k2, p1, p2, k3 = distortion[0], distortion[1], distortion[2], distortion[3], distortion[4]
    for u in range(depth.shape[0]):
        x = np.float64(x_out[u])
        y = np.float64(y_out[u])
        square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        radial = radial if square <= largest_square else np.nan
        x_out[u] = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
        y_out[u] = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y


@kernel
def _to_pixels(across: Floats32, down: Floats32, lens: npt.NDArray[np.float64]) -> None:
    """Slopes to pixels, half a pixel on, so that cutting off rounds."""
    fx = np.float32(lens[0])
    fy = np.float32(lens[1])
    cx = np.float32(lens[2] + 0.5)
    cy = np.float32(lens[3] + 0.5)
    for u in range(across.shape[0]):
        across[u] = fx * across[u] + cx
        down[u] = fy * down[u] + cy


@kernel
def sort_into_cells(
    cells: Integers32,  # [H, W]
    depths: Floats32,  # [H, W]
    places: Integers32,  # [H, W]
    color_depths: Floats32,  # [H, W]
    nearest: Floats32,  # [color_rows / BLOCK, color_columns / BLOCK]
    color_columns: int,
    color_every: int,
    starts: Integers32,  # [cells + 1]: counts, becomes where each cell's samples begin
    ends_out: Integers32,  # [cells]
    sample_depths_out: Floats32,  # [H W]
    sample_places_out: Integers32,  # [H W]
) -> int:
    """Samples cell by cell: depth, and colour pixel (-1 where the colour lens does not see the point). Returns the most."""
    most = 0
    for cell in range(ends_out.shape[0]):
        most = max(most, int(starts[cell + 1]))
        starts[cell + 1] += starts[cell]
        ends_out[cell] = starts[cell]
    for v in range(cells.shape[0]):
        for u in range(cells.shape[1]):
            cell = cells[v, u]
            if cell < 0:
                continue
            end = ends_out[cell]
            ends_out[cell] = end + 1
            sample_depths_out[end] = depths[v, u]
            sample_places_out[end] = -1
            if color_every == 1 or (u + v) & 1 == 0:
                place = places[v, u]
                if place >= 0:
                    block_v = place // color_columns // BLOCK
                    block_u = place % color_columns // BLOCK
                    if color_depths[v, u] <= nearest[block_v, block_u] + HIDDEN:
                        sample_places_out[end] = place
    return most


@kernel
def gather(
    starts: Integers32,  # [cells + 1]
    sample_depths: Floats32,  # [N]
    sample_places: Integers32,  # [N]
    colors: Bytes,  # [pixels, 3]
    fewest: int,
    matrix: npt.NDArray[np.float64],  # [3, 3]
    offset: npt.NDArray[np.float64],  # [3]
    ordered: Floats32,  # [most], scratch
    depth_out: Depths,  # [cells]
    color_out: Bytes,  # [cells, 3]
) -> None:
    """One depth and one colour for each published pixel, from the samples that fell into it.

    The median sample names the surface (of two with equal shares the nearer): depth is the mean of the samples within
    `surface_band` of it, colour the corrected mean of the same samples, so that two surfaces are never mixed. Fewer than
    `fewest` samples: depth 0. No sample that the colour lens sees: black.
    """
    for cell in range(depth_out.shape[0]):
        start = starts[cell]
        stop = starts[cell + 1]
        depth_out[cell] = 0
        color_out[cell, 0] = 0
        color_out[cell, 1] = 0
        color_out[cell, 2] = 0
        if stop - start < fewest or stop == start:
            continue
        low = sample_depths[start]
        high = low
        for position in range(start + 1, stop):
            low = min(low, sample_depths[position])
            high = max(high, sample_depths[position])
        band = surface_band(low)
        middle = 0.5 * (low + high)
        if high - low > band:
            middle = _median(sample_depths, start, stop, ordered)
            band = surface_band(middle)
        total = 0.0
        red = np.int64(0)
        green = np.int64(0)
        blue = np.int64(0)
        members = 0
        colored = 0
        for position in range(start, stop):
            if abs(sample_depths[position] - middle) <= band:
                total += sample_depths[position]
                members += 1
                place = sample_places[position]
                if place >= 0:
                    red += np.int64(colors[place, 0])
                    green += np.int64(colors[place, 1])
                    blue += np.int64(colors[place, 2])
                    colored += 1
        depth_out[cell] = np.uint16(min(1000.0 * total / members + 0.5, 65535.0))
        if colored > 0:
            scale = 1.0 / colored
            for channel in range(3):
                value = matrix[channel, 0] * red + matrix[channel, 1] * green + matrix[channel, 2] * blue
                color_out[cell, channel] = np.uint8(min(max(value * scale + offset[channel] + 0.5, 0.0), 255.0))


@kernel
def surface_band(depth: float) -> float:
    """How far, m, samples of one surface within one published pixel lie from their median: noise of stereo, and slant."""
    return 0.012 + 0.012 * depth * depth


@kernel
def _median(values: Floats32, start: int, stop: int, ordered: Floats32) -> float:
    """The lower median of values[start:stop], by insertion."""
    for position in range(stop - start):
        value = values[start + position]
        place = position
        while place > 0 and ordered[place - 1] > value:
            ordered[place] = ordered[place - 1]
            place -= 1
        ordered[place] = value
    return float(ordered[(stop - start - 1) // 2])
