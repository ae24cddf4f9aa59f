"""What stands on a real table: which AprilTag lies where, on which robot, on which box. File `table.json`.

Table frame: the arena frame (origin lower left corner, x right, y up, m, heading counter-clockwise from +x, rad), z up from
the floor. A tag's own x axis runs to the right of the tag when it is upright as its family publishes it (`tags.tag_cells`),
its own y axis to its top; a tag's heading is that of its x axis. Sizes are sides of the black square, without the white border.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from vantage.output import write_complete
from vantage.tracking.errors import UnusableTable
from vantage.world.arena import ARENA_SIZE, BOX_HEIGHT

TAG_COUNT = 587
"""Tags of the family tag36h11."""

TAG_CELLS = 8
"""Cells along the side of the black square of a tag36h11; one more cell of white all around belongs to the tag."""

Metres = Annotated[float, Meta(ge=-100.0, le=100.0)]
Length = Annotated[float, Meta(gt=0.0, le=10.0)]
Height = Annotated[float, Meta(ge=0.0, le=10.0)]
Radians = Annotated[float, Meta(ge=-1000.0, le=1000.0)]
TagId = Annotated[int, Meta(ge=0, lt=TAG_COUNT)]

MAXIMUM_FILE_SIZE = 1_000_000
"""bytes"""


class CornerTag(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A tag that lies on the floor at a known place; four of them tie the camera to the arena."""

    id: TagId
    x: Annotated[Metres, Meta(description="centre, m")]
    y: Annotated[Metres, Meta(description="centre, m")]
    heading: Annotated[Radians, Meta(description="of the tag's x axis, rad")] = 0.0


class RobotTag(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The tag on a robot."""

    id: TagId
    size: Annotated[Length, Meta(description="side of the black square, m")] = 0.06
    height: Annotated[Height, Meta(description="of the tag's plane above the floor, m")] = 0.13
    forward: Annotated[Metres, Meta(description="tag's centre ahead of the robot's centre, m")] = 0.0
    left: Annotated[Metres, Meta(description="tag's centre to the left of the robot's centre, m")] = 0.0
    heading: Annotated[Radians, Meta(description="of the tag's x axis relative to the robot's heading, rad")] = 0.0


class ObstacleTag(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A box and the tag on top of it."""

    id: TagId
    half_width: Annotated[Length, Meta(description="half the side along the box's own x, m")]
    half_depth: Annotated[Length, Meta(description="half the side along the box's own y, m")]
    height: Annotated[Length, Meta(description="of the box, and of the tag on it, above the floor, m")] = BOX_HEIGHT
    size: Annotated[Length, Meta(description="side of the black square, m")] = 0.06
    along: Annotated[Metres, Meta(description="tag's centre from the box's, along the box's x, m")] = 0.0
    across: Annotated[Metres, Meta(description="tag's centre from the box's, along the box's y, m")] = 0.0
    heading: Annotated[Radians, Meta(description="of the tag's x axis relative to the box's, rad")] = 0.0


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A real table."""

    width: Annotated[Length, Meta(description="of the arena along x, m")] = ARENA_SIZE
    depth: Annotated[Length, Meta(description="of the arena along y, m")] = ARENA_SIZE
    family: str = "tag36h11"
    corner_size: Annotated[Length, Meta(description="side of the corner tags' black square, m")] = 0.08
    corners: Annotated[tuple[CornerTag, ...], Meta(min_length=4, max_length=16)]
    robots: dict[str, RobotTag]
    obstacles: Annotated[tuple[ObstacleTag, ...], Meta(max_length=64)] = ()


def default_table() -> Table:
    """Return the table of the guide: 1.2 m square, tags 0 and 1 on the robots, 10 to 12 on boxes like those of the lab layout.

    The corner tags 20 to 23 lie left and right of the arena, far enough out for a camera 1.6 m above the middle of the table to
    see them over walls of 0.3 m.
    """
    return Table(
        corners=(
            CornerTag(id=20, x=-0.25, y=0.10),
            CornerTag(id=21, x=1.45, y=0.10),
            CornerTag(id=22, x=1.45, y=1.10),
            CornerTag(id=23, x=-0.25, y=1.10),
        ),
        robots={"hider": RobotTag(id=0), "seeker": RobotTag(id=1)},
        obstacles=(
            ObstacleTag(id=10, half_width=0.120, half_depth=0.060),
            ObstacleTag(id=11, half_width=0.060, half_depth=0.115),
            ObstacleTag(id=12, half_width=0.120, half_depth=0.055),
        ),
    )


def check_table(table: Table) -> None:
    """Check what the types cannot say.

    Raises:
        UnusableTable: another family, a tag used twice, a robot missing, tags larger than what carries them, corner tags in line.
    """
    if table.family != "tag36h11":
        raise UnusableTable(f"tags of the family {table.family} are not supported: print tag36h11 with `vantage table print`")
    ids = [tag.id for tag in table.corners] + [tag.id for tag in table.robots.values()] + [tag.id for tag in table.obstacles]
    twice = sorted({tag for tag in ids if ids.count(tag) > 1})
    if twice:
        raise UnusableTable(f"tag {', '.join(map(str, twice))} stands more than once in the table: give every tag its own id")
    if sorted(table.robots) != ["hider", "seeker"]:
        raise UnusableTable(f"the table must have the robots hider and seeker, it has: {', '.join(table.robots) or 'none'}")
    for tag in table.obstacles:
        if tag.size / 2 > min(tag.half_width, tag.half_depth):
            raise UnusableTable(f"the tag {tag.id} of {tag.size * 1000:.0f} mm does not fit on its box: correct its size")
    across = max(c.x for c in table.corners) - min(c.x for c in table.corners)
    along = max(c.y for c in table.corners) - min(c.y for c in table.corners)
    if across < table.width / 2 or along < table.depth / 2:
        raise UnusableTable("the corner tags lie too close together: put one near each corner of the arena and enter its place")


def load_table(path: Path) -> Table:
    """Read a table's description.

    Raises:
        UnusableTable: no such file, not JSON of a table, or not usable (see `check_table`).
    """
    try:
        if path.stat().st_size > MAXIMUM_FILE_SIZE:
            raise UnusableTable(f"{path} is not the description of a table: it has more than {MAXIMUM_FILE_SIZE} bytes")
        table = msgspec.json.decode(path.read_bytes(), type=Table)
    except OSError as error:
        raise UnusableTable(f"cannot read the table {path}: {error.strerror}; `vantage table print` writes one") from error
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UnusableTable(f"{path} is not the description of a table: {error}; correct it or write it anew") from error
    try:
        check_table(table)
    except UnusableTable as error:
        raise UnusableTable(f"{path}: {error}") from error
    return table


def save_table(table: Table, path: Path) -> None:
    """Write a table's description, replacing the file at once.

    Raises:
        UnusableTable: it is not usable.
    """
    check_table(table)
    write_complete(path, msgspec.json.format(msgspec.json.encode(table), indent=2) + b"\n")
