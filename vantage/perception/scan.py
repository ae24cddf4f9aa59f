"""From a depth and a colour image to one range a column, and to the other robot: the one definition of "seen".

A column holds the nearest surface above the floor. Pixels sit at integer coordinates: column u looks along
(u - cx) / fx to the right of the optical axis, row v along (v - cy) / fy below it; the axis is horizontal.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vantage.compiled import kernel
from vantage.world.arena import HIDER_COLOR, ROBOT_RADIUS, SEEKER_COLOR

NOTHING = 0
SURFACE = 1
ROBOT = 2

FLOOR_HEIGHT = 0.015
"""m: what stands lower than this is floor."""
FLOOR_SLOPE = 0.01
"""m per m of range: by how much the floor's limit rises, for the noise of depth grows with range."""
COLOR_DISTANCE = 0.16
"""Greatest distance of a pixel's chromaticity (r, g, b) / (r + g + b) from the robot's; grey is 0.36 or more away."""
DARKEST = 60
"""Least r + g + b of a pixel whose chromaticity can be trusted in 8 bits of noise."""
SUPPORT_HEIGHT = 0.02
"""m: a surface must fill this height of a column, where there are rows enough, or it is a flying pixel."""

_BIN_SHIFT = 4  # depth is gathered in bins of 16 mm
_BINS = 256


def _chromaticity(color: tuple[int, int, int]) -> tuple[float, float, float]:
    total = float(sum(color))
    return (color[0] / total, color[1] / total, color[2] / total)


_HIDER = _chromaticity(HIDER_COLOR)
_SEEKER = _chromaticity(SEEKER_COLOR)


@kernel
def is_robot_color(red: int, green: int, blue: int, other_color: int) -> bool:
    """Whether a pixel (0..255 each) has the body colour of the hider (`other_color` 0) or the seeker (1)."""
    total = float(red) + float(green) + float(blue)
    if total < DARKEST:
        return False
    target = _HIDER if other_color == 0 else _SEEKER
    scale = 1.0 / total
    difference_red = red * scale - target[0]
    difference_green = green * scale - target[1]
    difference_blue = blue * scale - target[2]
    square = difference_red * difference_red + difference_green * difference_green + difference_blue * difference_blue
    return square < COLOR_DISTANCE * COLOR_DISTANCE


@kernel
def _floor_limit(row: int, fy: float, cy: float, mount_height: float) -> int:
    """Depth in mm from which a pixel of this row is floor: where its height falls to the floor's limit."""
    descent = (row - cy) / fy + FLOOR_SLOPE
    if descent <= 0.0:
        return 65535
    return int(min(65535.0, max(0.0, 1000.0 * (mount_height - FLOOR_HEIGHT) / descent)))


@kernel
def scan_columns(
    depth: NDArray[np.uint16],  # [H, W]
    color: NDArray[np.uint8],  # [H, W, 3]
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    mount_height: float,
    other_color: int,
    ranges_out: NDArray[np.float64],  # [W]
    kinds_out: NDArray[np.uint8],  # [W]
) -> None:
    """Finds, per column, the nearest surface above the floor.

    `ranges_out`: distance along the optical axis in m, NaN where no row has a return above the floor. `kinds_out`: 0
    nothing, 1 a surface, 2 the other robot, whose colour (`other_color`: 0 hider, 1 seeker) fills half of the surface.

    With several rows a surface is a cluster of depths that fills `SUPPORT_HEIGHT` of the column; its range is the
    cluster's mean. A minimum over rows would sit closer the more rows there are.
    """
    height, width = depth.shape
    if height == 1:
        limit = _floor_limit(0, fy, cy, mount_height)
        for u in range(width):
            value = np.int64(depth[0, u])
            if value == 0 or value >= limit:
                ranges_out[u] = np.nan
                kinds_out[u] = NOTHING
            else:
                ranges_out[u] = 0.001 * value
                kinds_out[u] = ROBOT if is_robot_color(color[0, u, 0], color[0, u, 1], color[0, u, 2], other_color) else SURFACE
        return
    _scan_rows(depth, color, fy, cy, mount_height, other_color, ranges_out, kinds_out)


@kernel
def _scan_rows(
    depth: NDArray[np.uint16],
    color: NDArray[np.uint8],
    fy: float,
    cy: float,
    mount_height: float,
    other_color: int,
    ranges_out: NDArray[np.float64],
    kinds_out: NDArray[np.uint8],
) -> None:
    height, width = depth.shape
    counts = np.zeros((width, _BINS + 1), np.uint16)
    for v in range(height):
        limit = _floor_limit(v, fy, cy, mount_height)
        for u in range(width):
            value = np.int64(depth[v, u])
            if value != 0 and value < limit:
                number = value >> _BIN_SHIFT
                if number > _BINS - 1:
                    number = np.int64(_BINS - 1)
                counts[u, number] += 1

    nearest = np.zeros(width, np.int64)
    farthest = np.zeros(width, np.int64)
    for u in range(width):
        for b in range(_BINS):
            here = np.int64(counts[u, b]) + np.int64(counts[u, b + 1])
            if here == 0:
                continue
            distance = 0.001 * ((b + 1) << _BIN_SHIFT)
            if here < max(1, min((height + 1) // 2, int(SUPPORT_HEIGHT * fy / distance))):
                continue
            # Climb to the middle of the cluster, so that the window is not cut from its near tail.
            while b + 2 <= _BINS and np.int64(counts[u, b + 1]) + np.int64(counts[u, b + 2]) > here:
                b += 1
                here = np.int64(counts[u, b]) + np.int64(counts[u, b + 1])
            nearest[u] = max(1, (b - 1) << _BIN_SHIFT)
            farthest[u] = 65536 if b + 2 >= _BINS else (b + 3) << _BIN_SHIFT
            break

    sums = np.zeros(width, np.int64)
    members = np.zeros(width, np.int64)
    colored = np.zeros(width, np.int64)
    for v in range(height):
        limit = _floor_limit(v, fy, cy, mount_height)
        for u in range(width):
            value = np.int64(depth[v, u])
            if value < limit and nearest[u] <= value < farthest[u]:
                sums[u] += value
                members[u] += 1
                colored[u] += is_robot_color(color[v, u, 0], color[v, u, 1], color[v, u, 2], other_color)

    for u in range(width):
        if members[u] == 0:
            ranges_out[u] = np.nan
            kinds_out[u] = NOTHING
        else:
            ranges_out[u] = 0.001 * sums[u] / members[u]
            kinds_out[u] = ROBOT if 2 * colored[u] >= members[u] else SURFACE


@kernel
def find_other(
    ranges: NDArray[np.float64],  # [W]
    kinds: NDArray[np.uint8],  # [W]
    fx: float,
    cx: float,
    x: float,
    y: float,
    heading: float,
) -> tuple[int, bool, float, float]:
    """Where the other robot is: (seen_columns, whole, other_x, other_y), centre in the arena frame, m.

    Fits the disc of ROBOT_RADIUS to the columns of its colour (robust Gauss-Newton on the distance of each column's
    point from the circle), held sideways by the tangents at those limbs that nothing hides. `seen_columns` counts the
    columns of its colour; the centre is NaN where there is none. `whole`: both limbs are inside the picture and hidden
    by nothing nearer, and the angle between them is the disc's, 2 asin(r / distance), within 15 % and two columns.
    """
    width = ranges.shape[0]
    seen = 0
    first = -1
    last = -1
    most = 0
    run_first = 0
    run_last = -10
    run_count = 0
    for u in range(width):
        if kinds[u] != ROBOT:
            continue
        seen += 1
        if u - run_last > 3:
            run_first = u
            run_count = 0
        run_last = u
        run_count += 1
        if run_count > most:
            most = run_count
            first = run_first
            last = run_last
    if seen == 0:
        return 0, False, np.nan, np.nan

    sum_range = 0.0
    for u in range(first, last + 1):
        if kinds[u] == ROBOT:
            sum_range += ranges[u]
    distance = sum_range / most + 0.75 * ROBOT_RADIUS
    ahead = distance
    right = distance * (0.5 * (first + last) - cx) / fx

    left_tangent, left_weight = _limb(ranges, kinds, first, -1, fx, cx)
    right_tangent, right_weight = _limb(ranges, kinds, last, 1, fx, cx)
    left_scale = 1.0 / math.sqrt(1.0 + left_tangent * left_tangent)
    right_scale = 1.0 / math.sqrt(1.0 + right_tangent * right_tangent)

    for _ in range(5):
        # Normal equations of the step; the small diagonal holds the centre where the columns do not.
        aa = 0.05
        ab = 0.0
        bb = 0.05
        ga = 0.0
        gb = 0.0
        for u in range(first, last + 1):
            if kinds[u] != ROBOT:
                continue
            da = ahead - ranges[u]
            db = right - ranges[u] * (u - cx) / fx
            length = math.sqrt(da * da + db * db) + 1e-9
            residual = length - ROBOT_RADIUS
            weight = min(1.0, 0.02 / (abs(residual) + 1e-9))
            da /= length
            db /= length
            aa += weight * da * da
            ab += weight * da * db
            bb += weight * db * db
            ga += weight * da * residual
            gb += weight * db * residual
        if left_weight > 0.0:
            na = -left_tangent * left_scale
            nb = left_scale
            residual = na * ahead + nb * right - ROBOT_RADIUS
            aa += left_weight * na * na
            ab += left_weight * na * nb
            bb += left_weight * nb * nb
            ga += left_weight * na * residual
            gb += left_weight * nb * residual
        if right_weight > 0.0:
            na = -right_tangent * right_scale
            nb = right_scale
            residual = na * ahead + nb * right + ROBOT_RADIUS
            aa += right_weight * na * na
            ab += right_weight * na * nb
            bb += right_weight * nb * nb
            ga += right_weight * na * residual
            gb += right_weight * nb * residual
        determinant = aa * bb - ab * ab
        ahead -= (bb * ga - ab * gb) / determinant
        right -= (aa * gb - ab * ga) / determinant

    whole = False
    distance = math.sqrt(ahead * ahead + right * right)
    if left_weight > 0.0 and right_weight > 0.0 and distance > ROBOT_RADIUS:
        expected = 2.0 * math.asin(ROBOT_RADIUS / distance)
        measured = math.atan(right_tangent) - math.atan(left_tangent)
        whole = abs(measured - expected) <= 0.15 * expected + 2.0 / fx
    cosine = math.cos(heading)
    sine = math.sin(heading)
    return seen, whole, x + ahead * cosine + right * sine, y + ahead * sine - right * cosine


@kernel
def _limb(
    ranges: NDArray[np.float64], kinds: NDArray[np.uint8], edge: int, side: int, fx: float, cx: float
) -> tuple[float, float]:
    """Tangent (sideways per ahead) of the limb beyond column `edge`, and its weight: 0 where the limb is not to be seen."""
    width = ranges.shape[0]
    outside = edge + side
    gap = 0
    while 0 <= outside < width and kinds[outside] == NOTHING and gap < 4:
        outside += side
        gap += 1
    tangent = (edge + side * 0.5 * (1 + gap) - cx) / fx
    if edge == 0 or edge == width - 1:
        return tangent, 0.0
    if 0 <= outside < width and kinds[outside] != NOTHING and ranges[outside] < ranges[edge]:
        return tangent, 0.0
    return tangent, 4.0 / (1.0 + gap)
