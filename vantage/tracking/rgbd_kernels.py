"""Compiled steps of `rgbd.RgbdPreparer`: registration of depth to the colour lens, and gathering into the published pixels."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from vantage.compiled import kernel

Floats32 = npt.NDArray[np.float32]
Depths = npt.NDArray[np.uint16]
Bytes = npt.NDArray[np.uint8]


@kernel
def register(
    depth: Depths,  # [H, W]
    rays: Floats32,  # [H, W, 3]: direction of each depth pixel in the colour frame, per unit of depth
    shift_x: float,
    shift_y: float,
    shift_z: float,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    distortion: Floats32,  # [5]
    is_distorted: bool,
    largest_square: float,
    footprint: float,
    unit: float,
    nearest: float,
    registered_out: Floats32,  # [Hc, Wc]
) -> None:
    """Forward projection of depth into the colour picture: the nearest wins; 0 = no return. Depth along the colour axis, m.

    A depth pixel covers the colour pixels whose centres lie in a square of side `footprint` px around its projection, or,
    where `footprint` <= 1, the one pixel it falls into. `largest_square`: beyond this x^2 + y^2 the distortion is not trusted.
    """
    rows, columns = depth.shape
    rows_out, columns_out = registered_out.shape
    k1 = np.float64(distortion[0])
    k2 = np.float64(distortion[1])
    p1 = np.float64(distortion[2])
    p2 = np.float64(distortion[3])
    k3 = np.float64(distortion[4])
    half = 0.5 * footprint
    for v in range(rows_out):
        for u in range(columns_out):
            registered_out[v, u] = np.float32(np.inf)
    for v in range(rows):
        for u in range(columns):
            count = depth[v, u]
            if count == 0:
                continue
            z = unit * count
            if z < nearest:
                continue
            z_color = z * rays[v, u, 2] + shift_z
            if z_color <= 1e-3:
                continue
            inverse = 1.0 / z_color
            x = (z * rays[v, u, 0] + shift_x) * inverse
            y = (z * rays[v, u, 1] + shift_y) * inverse
            if is_distorted:
                square = x * x + y * y
                if square > largest_square:
                    continue
                radial = 1.0 + square * (k1 + square * (k2 + square * k3))
                bent = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
                y = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
                x = bent
            across = fx * x + cx
            down = fy * y + cy
            if not (-2.0 < across < columns_out + 1.0 and -2.0 < down < rows_out + 1.0):
                continue
            value = np.float32(z_color)
            if footprint <= 1.0:
                column = int(across + 2.5) - 2
                row = int(down + 2.5) - 2
                if 0 <= column < columns_out and 0 <= row < rows_out and value < registered_out[row, column]:
                    registered_out[row, column] = value
                continue
            for row in range(max(0, math.ceil(down - half)), min(rows_out, math.ceil(down + half))):
                for column in range(max(0, math.ceil(across - half)), min(columns_out, math.ceil(across + half))):
                    if value < registered_out[row, column]:
                        registered_out[row, column] = value
    for v in range(rows_out):
        for u in range(columns_out):
            if registered_out[v, u] == np.inf:
                registered_out[v, u] = np.float32(0.0)


@kernel
def level(
    registered: Floats32,  # [N]: Hc x Wc pixels
    rays: Floats32,  # [N, 3]: direction of each colour pixel in the level frame, per unit of depth
    origin_x: float,
    origin_y: float,
    origin_z: float,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    rows_out: int,
    columns_out: int,
    cells_out: npt.NDArray[np.int32],  # [N]
    depths_out: Floats32,  # [N]
    starts_out: npt.NDArray[np.int32],  # [cells + 1]
) -> int:
    """Which published pixel each colour pixel with depth falls into (-1: none), and its depth along the level axis in m.

    Leaves in `starts_out` where each published pixel's samples begin when sorted by pixel; returns the most of any.
    """
    cells = rows_out * columns_out
    for cell in range(cells + 1):
        starts_out[cell] = 0
    for index in range(registered.shape[0]):
        cells_out[index] = -1
        z = np.float64(registered[index])
        if z <= 0.0:
            continue
        z_level = z * rays[index, 2] + origin_z
        if z_level <= 1e-3:
            continue
        inverse = 1.0 / z_level
        across = fx * (z * rays[index, 0] + origin_x) * inverse + cx + 0.5
        down = fy * (z * rays[index, 1] + origin_y) * inverse + cy + 0.5
        if not (0.0 <= across < columns_out and 0.0 <= down < rows_out):
            continue
        cell = int(down) * columns_out + int(across)
        cells_out[index] = cell
        depths_out[index] = z_level
        starts_out[cell + 1] += 1
    most = 0
    for cell in range(cells):
        most = max(most, np.int64(starts_out[cell + 1]))
        starts_out[cell + 1] += starts_out[cell]
    return most


@kernel
def gather(
    cells: npt.NDArray[np.int32],  # [N]
    depths: Floats32,  # [N]
    colors: Bytes,  # [N, 3]
    starts: npt.NDArray[np.int32],  # [cells + 1]
    ends: npt.NDArray[np.int32],  # [cells], scratch
    order: npt.NDArray[np.int32],  # [N], scratch
    sorted_depths: Floats32,  # [most], scratch
    fewest: int,
    matrix: Floats32,  # [3, 3]
    offset: Floats32,  # [3]
    depth_out: Depths,  # [cells]
    color_out: Bytes,  # [cells, 3]
) -> None:
    """One depth and one colour for each published pixel, from the samples that fell into it.

    The median sample names the surface; depth is the mean of the samples within `_band` of it, colour the corrected mean of
    the same samples, so that two surfaces are never mixed. Fewer than `fewest` samples: 0, black.
    """
    count = depth_out.shape[0]
    for cell in range(count):
        ends[cell] = starts[cell]
    for index in range(cells.shape[0]):
        cell = cells[index]
        if cell >= 0:
            order[ends[cell]] = index
            ends[cell] += 1
    for cell in range(count):
        start = starts[cell]
        stop = starts[cell + 1]
        samples = stop - start
        depth_out[cell] = 0
        color_out[cell, 0] = 0
        color_out[cell, 1] = 0
        color_out[cell, 2] = 0
        if samples < fewest or samples == 0:
            continue
        for position in range(samples):
            value = depths[order[start + position]]
            place = position
            while place > 0 and sorted_depths[place - 1] > value:
                sorted_depths[place] = sorted_depths[place - 1]
                place -= 1
            sorted_depths[place] = value
        # The lower median: of two surfaces with equal shares, the nearer.
        median = np.float64(sorted_depths[(samples - 1) // 2])
        band = _band(median)
        total = 0.0
        red = 0.0
        green = 0.0
        blue = 0.0
        members = 0
        for position in range(start, stop):
            index = order[position]
            if abs(depths[index] - median) <= band:
                total += depths[index]
                red += colors[index, 0]
                green += colors[index, 1]
                blue += colors[index, 2]
                members += 1
        scale = 1.0 / members
        depth_out[cell] = np.uint16(min(1000.0 * total * scale + 0.5, 65535.0))
        red *= scale
        green *= scale
        blue *= scale
        for channel in range(3):
            value = matrix[channel, 0] * red + matrix[channel, 1] * green + matrix[channel, 2] * blue + offset[channel]
            color_out[cell, channel] = np.uint8(min(max(value + 0.5, 0.0), 255.0))


@kernel
def _band(depth: float) -> float:
    """Half the depth range, m, of one surface within one published pixel: noise of a stereo camera and slant."""
    return 0.012 + 0.012 * depth * depth
