"""Layouts: the fixed `lab`, the drawn `random`, and layout files."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import numpy.typing as npt

from schemas import Box, Layout
from vantage.compiled import kernel
from vantage.errors import UserError
from vantage.world.arena import ARENA_SIZE, BOX_HEIGHT, ROBOT_RADIUS
from vantage.world.motion import box_distance, is_free
from vantage.world.noise import LAYOUT_STREAM, uniform

RANDOM_BOX_COUNT = 3
RANDOM_HALF_SIDE_MINIMUM = 0.050
RANDOM_HALF_SIDE_MAXIMUM = 0.120
MINIMUM_GAP = 0.150
"""Free space between boxes, and between boxes and walls, m: a robot (130 mm) passes everywhere."""

RANDOM_ATTEMPTS = 100_000
_DRAWS_PER_BOX = 16

MAXIMUM_FILE_SIZE = 1_000_000
"""bytes"""

Floats = npt.NDArray[np.float64]


class ImpossibleLayout(UserError, ValueError):
    """A layout nobody can play in; the text says what is wrong and what to do."""


class LayoutFile(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """A layout file, JSON or (suffix `.msgpack`) MessagePack: `{"obstacles": [{"x": 0.4, "y": 0.6, "half_width": ...}]}`."""

    obstacles: Annotated[tuple[Box, ...], msgspec.Meta(max_length=64)]


LAB: tuple[Box, ...] = (
    Box(x=0.330, y=0.810, half_width=0.120, half_depth=0.060, heading=math.radians(30.0)),
    Box(x=0.860, y=0.800, half_width=0.060, half_depth=0.115),
    Box(x=0.600, y=0.345, half_width=0.120, half_depth=0.055, heading=math.radians(-20.0)),
)
"""Three boxes with a hiding place behind each, all gaps at least 150 mm."""


def boxes_of(layout: Layout) -> Floats:
    """The obstacles of a layout as the kernels want them: float64 [n, 7] = x, y, half_width, half_depth, cos, sin, height."""
    return boxes_array(layout.obstacles)


def boxes_array(obstacles: tuple[Box, ...]) -> Floats:
    """As `boxes_of`, from the obstacles alone."""
    rows = [(b.x, b.y, b.half_width, b.half_depth, math.cos(b.heading), math.sin(b.heading), b.height) for b in obstacles]
    return np.array(rows, dtype=np.float64).reshape(len(rows), 7)


@kernel
def _corner(boxes: Floats, index: int, corner: int) -> tuple[float, float]:
    local_x = boxes[index, 2] if corner & 1 else -boxes[index, 2]
    local_y = boxes[index, 3] if corner & 2 else -boxes[index, 3]
    cosine = boxes[index, 4]
    sine = boxes[index, 5]
    return boxes[index, 0] + cosine * local_x - sine * local_y, boxes[index, 1] + sine * local_x + cosine * local_y


@kernel
def wall_gap(boxes: Floats, index: int, width: float, depth: float) -> float:
    """Distance of a box from the nearest wall, m; negative when it reaches through."""
    gap = np.inf
    for corner in range(4):
        x, y = _corner(boxes, index, corner)
        gap = min(gap, x, y, width - x, depth - y)
    return gap


@kernel
def box_gap(boxes: Floats, first: int, second: int) -> float:
    """Distance between two boxes, m; 0 when a corner of one lies in the other.

    (Two disjoint rectangles are nearest at a corner of one of them.)
    """
    gap = np.inf
    for corner in range(4):
        x, y = _corner(boxes, first, corner)
        gap = min(gap, box_distance(boxes, second, x, y))
        x, y = _corner(boxes, second, corner)
        gap = min(gap, box_distance(boxes, first, x, y))
    return gap


@kernel
def propose_box(seed: int, attempt: int, index: int, width: float, depth: float, boxes_out: Floats) -> float:
    """Draw one box of the layout `random`, far enough from every wall, into row `index` of float64 [n, 7]; return its
    heading, rad.

    Whether it is far enough from other boxes is for the caller to check.
    """
    span = RANDOM_HALF_SIDE_MAXIMUM - RANDOM_HALF_SIDE_MINIMUM
    draw = _DRAWS_PER_BOX * index
    heading = math.pi * uniform(seed, LAYOUT_STREAM, attempt, draw)
    half_width = RANDOM_HALF_SIDE_MINIMUM + span * uniform(seed, LAYOUT_STREAM, attempt, draw + 1)
    half_depth = RANDOM_HALF_SIDE_MINIMUM + span * uniform(seed, LAYOUT_STREAM, attempt, draw + 2)
    cosine = math.cos(heading)
    sine = math.sin(heading)
    reach_x = abs(cosine) * half_width + abs(sine) * half_depth + MINIMUM_GAP
    reach_y = abs(sine) * half_width + abs(cosine) * half_depth + MINIMUM_GAP
    boxes_out[index, 0] = reach_x + (width - 2.0 * reach_x) * uniform(seed, LAYOUT_STREAM, attempt, draw + 3)
    boxes_out[index, 1] = reach_y + (depth - 2.0 * reach_y) * uniform(seed, LAYOUT_STREAM, attempt, draw + 4)
    boxes_out[index, 2] = half_width
    boxes_out[index, 3] = half_depth
    boxes_out[index, 4] = cosine
    boxes_out[index, 5] = sine
    boxes_out[index, 6] = BOX_HEIGHT
    return heading


@kernel
def draw_boxes(seed: int, width: float, depth: float, boxes_out: Floats, headings_out: Floats) -> bool:
    """Draw the layout `random` of a seed into float64 [n, 7] and float64 [n] (rad): all boxes anew until every gap is wide.

    Returns False when too many draws failed (too many boxes, or too small an arena).
    """
    for attempt in range(RANDOM_ATTEMPTS):
        wide_enough = True
        for index in range(boxes_out.shape[0]):
            headings_out[index] = propose_box(seed, attempt, index, width, depth, boxes_out)
            for other in range(index):
                # Boxes that cross without a corner inside stick out by at most 70 mm, less than the gap: refused too.
                wide_enough = wide_enough and box_gap(boxes_out, index, other) >= MINIMUM_GAP
        if wide_enough:
            return True
    return False


def _random_layout(seed: int) -> tuple[Box, ...]:
    boxes = np.empty((RANDOM_BOX_COUNT, 7))
    headings = np.empty(RANDOM_BOX_COUNT)
    if not draw_boxes(seed, ARENA_SIZE, ARENA_SIZE, boxes, headings):
        raise ImpossibleLayout(f"no random layout found for seed {seed}; take another seed")
    return tuple(
        Box(x=x, y=y, half_width=half_width, half_depth=half_depth, heading=heading, height=height)
        for (x, y, half_width, half_depth, _, _, height), heading in zip(boxes.tolist(), headings.tolist(), strict=True)
    )


def read_layout(path: Path) -> tuple[Box, ...]:
    """Read and check a layout file. Raises `ImpossibleLayout`."""
    try:
        if not path.is_file():
            raise OSError("no such file")
        if path.stat().st_size > MAXIMUM_FILE_SIZE:
            raise OSError(f"larger than {MAXIMUM_FILE_SIZE} bytes")
        data = path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a path with a null byte
        raise ImpossibleLayout(
            f"layout {str(path)!r} cannot be read ({error}); give `lab`, `random` or the path of a layout file"
        ) from error
    try:
        if path.suffix == ".msgpack":
            file = msgspec.msgpack.decode(data, type=LayoutFile)
        else:
            file = msgspec.json.decode(data, type=LayoutFile)
    except msgspec.ValidationError as error:
        raise ImpossibleLayout(f"layout file {path} does not describe boxes: {error}; correct that field") from error
    except RecursionError as error:
        raise ImpossibleLayout(f"layout file {path} does not describe boxes: it is nested too deep") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        kind = "MessagePack" if path.suffix == ".msgpack" else "JSON"
        raise ImpossibleLayout(
            f'layout file {path} is not {kind}: {error}; it should read {{"obstacles": [{{"x": ..., "y": ..., '
            f'"half_width": ..., "half_depth": ...}}]}}'
        ) from error
    try:
        check_layout(file.obstacles, ARENA_SIZE, ARENA_SIZE)
    except ImpossibleLayout as error:
        raise ImpossibleLayout(f"layout file {path}: {error}") from error
    return file.obstacles


def check_layout(obstacles: tuple[Box, ...], width: float, depth: float) -> None:
    """Raise `ImpossibleLayout` unless all boxes stand inside the arena (m) and leave room for a robot."""
    boxes = boxes_array(obstacles)
    for index, box in enumerate(obstacles):
        if wall_gap(boxes, index, width, depth) < -1e-9:
            raise ImpossibleLayout(
                f"obstacle {index} at ({box.x:g}, {box.y:g}) m overlaps a wall of the {width:g} x {depth:g} m arena; "
                "move it inward or make it smaller"
            )
        if box.height <= 0.0:
            raise ImpossibleLayout(f"obstacle {index} at ({box.x:g}, {box.y:g}) m has no height; give it one above 0 m")
    if not _has_room(boxes, width, depth):
        raise ImpossibleLayout(
            f"the {len(obstacles)} obstacles leave no free place for a robot of {1000 * ROBOT_RADIUS:g} mm radius; "
            "take some away or make them smaller"
        )


@kernel
def _has_room(boxes: Floats, width: float, depth: float) -> bool:
    spacing = 0.01
    for row in range(int(depth / spacing)):
        for column in range(int(width / spacing)):
            if is_free(boxes, width, depth, (column + 0.5) * spacing, (row + 0.5) * spacing, ROBOT_RADIUS):
                return True
    return False


@lru_cache(maxsize=16)
def _read_version(path: Path, modified: int) -> tuple[Box, ...]:
    return read_layout(path)


def make_layout(name: str, seed: int) -> tuple[Box, ...]:
    """The obstacles of `lab`, of `random` for a seed, or of a layout file.

    Raises `ImpossibleLayout` when the file is missing, broken, or describes an arena nobody can play in.
    """
    if name == "lab":
        return LAB
    if name == "random":
        return _random_layout(seed)
    path = Path(name)
    try:
        return _read_version(path, path.stat().st_mtime_ns)
    except (OSError, ValueError):
        return read_layout(path)
