"""Draws the table of the guide from its constants: `python -m vantage.setting_up.drawings` renews docs/table/ and the generated
tables of docs/table.md.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

from schemas import Box
from vantage.setting_up.optics import Mounting, highest_wall, mounting
from vantage.setting_up.svg import FAINT, Svg
from vantage.tracking.table import TAG_CELLS, Table, default_table
from vantage.tracking.tags import tag_cells
from vantage.world.arena import GOALS, HIDER_COLOR, MOUNT_HEIGHT, ROBOT_HEIGHT, ROBOT_RADIUS, SEEKER_COLOR, WALL_HEIGHT
from vantage.world.layout import LAB

DOCS: Final = Path(__file__).resolve().parents[2] / "docs"
VIEWS: Final = (60.0, 65.0, 70.0, 78.0, 90.0)
"""Horizontal angles of view that cameras have, degrees."""
DRAWN_VIEW: Final = 70.0
BODY: Final = (0.130, 0.110)
"""Length and width of the paper's robots, m."""

_ROBOTS = {"hider": ((0.30, 0.28), 0.5, HIDER_COLOR), "seeker": ((0.80, 0.50), 2.6, SEEKER_COLOR)}
_TABLE_TOP = "#eef0f2"
_FLOOR = "#d9d7d2"
_WALL = "#b9b6b0"
_BOX = "#b3a998"
_BLUE = "#0369a1"
_ORANGE = "#b45309"


def plan(table: Table) -> str:
    """Return the table from above: arena, goals, tags, an example of boxes and robots, what the camera sees; mm."""
    hung = mounting(table, math.radians(DRAWN_VIEW))
    half_x = hung.height * math.tan(hung.view / 2)
    half_y = half_x * 720 / 1280
    middle = (table.width / 2, table.depth / 2)
    edge = max(abs(tag.x - middle[0]) for tag in table.corners) + 0.16
    drawing = Svg(
        min(middle[0] - half_x, middle[0] - edge) - 0.06,
        min(middle[1] - half_y, 0.0) - 0.14,
        max(middle[0] + half_x, middle[0] + edge) + 0.06,
        max(middle[1] + half_y, table.depth) + 0.08,
        400.0,
        "The table from above: frame, tags and goals (mm)",
    )
    drawing.rectangle(
        middle[0] - edge,
        min(0.0, middle[1] - half_y) - 0.02,
        2 * edge,
        max(2 * half_y, table.depth) + 0.04,
        f'fill="{_TABLE_TOP}"',
    )
    drawing.rectangle(-0.012, -0.012, table.width + 0.024, table.depth + 0.024, f'fill="{_WALL}"')
    drawing.rectangle(0.0, 0.0, table.width, table.depth, f'fill="{_FLOOR}"')
    for x, y in GOALS:
        drawing.dot(float(x), float(y), "#ffffff")
    for box, tag in zip(LAB, table.obstacles, strict=False):
        drawing.polygon(_outline(box), f'fill="{_BOX}" stroke="{FAINT}"')
        _tag(drawing, tag.id, box.x, box.y, tag.size, box.heading + tag.heading)
        drawing.text(box.x, box.y, str(tag.id), shift=(24.0, 20.0), size=12)
    for robot, ((x, y), heading, color) in _ROBOTS.items():
        mount = table.robots[robot]
        drawing.circle(x, y, ROBOT_RADIUS, f'fill="rgb{color}" fill-opacity="0.5" stroke="rgb{color}"')
        _tag(drawing, mount.id, x, y, mount.size, heading + mount.heading)
        tip = (x + 2.1 * ROBOT_RADIUS * math.cos(heading), y + 2.1 * ROBOT_RADIUS * math.sin(heading))
        drawing.arrow((x + ROBOT_RADIUS * math.cos(heading), y + ROBOT_RADIUS * math.sin(heading)), tip, f"rgb{color}", 2.5)
        drawing.text(x, y - ROBOT_RADIUS, f"{robot}, tag {mount.id}", shift=(0.0, 15.0), size=12)
    for corner in table.corners:
        _tag(drawing, corner.id, corner.x, corner.y, table.corner_size, corner.heading)
        drawing.text(corner.x, corner.y - table.corner_size * 0.65, f"tag {corner.id}", shift=(0.0, 13.0), bold=True)
        where = f"x {1000 * corner.x:g}, y {1000 * corner.y:g}"
        drawing.text(corner.x, corner.y - table.corner_size * 0.65, where, shift=(0.0, 28.0), size=12)
    drawing.arrow((0.0, 0.0), (0.16, 0.0), "#dc2626", 3.0)
    drawing.arrow((0.0, 0.0), (0.0, 0.16), "#16a34a", 3.0)
    drawing.text(0.17, 0.0, "x", "#dc2626", shift=(2.0, -5.0), bold=True)
    drawing.text(0.0, 0.17, "y", "#16a34a", shift=(10.0, -2.0), bold=True)
    drawing.text(0.0, 0.0, "origin (0, 0)", shift=(4.0, 20.0), anchor="start", size=12)
    low = min(middle[1] - half_y, 0.0) - 0.075
    drawing.measure((0.0, low), (table.width, low), f"{1000 * table.width:g}")
    right = table.width + 0.05
    drawing.measure((right, 0.0), (right, table.depth), f"{1000 * table.depth:g}", shift=(18.0, 4.0))
    frame = [(middle[0] + a * half_x, middle[1] + b * half_y) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))]
    drawing.line(frame, _BLUE, 1.2, "7 5")
    drawing.text(middle[0] - half_x, middle[1] + half_y, _camera_text(hung), _BLUE, anchor="start", shift=(6.0, -6.0), size=12)
    return str(drawing)


def side(table: Table) -> str:
    """Return the table from the side: the camera's height, sight lines to the corner tags, heights of tags and walls."""
    hung = mounting(table, math.radians(DRAWN_VIEW))
    middle = table.width / 2
    edge = max(abs(tag.x - middle) for tag in table.corners) + 0.16
    wall = min(WALL_HEIGHT, highest_wall(table, hung.height))
    drawing = Svg(
        middle - edge - 0.30, -0.14, middle + edge + 0.42, hung.height + 0.14, 300.0, "The table from the side: heights (mm)"
    )
    drawing.rectangle(middle - edge, -0.03, 2 * edge, 0.03, f'fill="{_WALL}"')
    half_x = hung.height * math.tan(hung.view / 2)
    camera = (middle, hung.height)
    drawing.polygon((camera, (middle - half_x, 0.0), (middle + half_x, 0.0)), f'fill="{_BLUE}" fill-opacity="0.07"')
    half = table.corner_size * (TAG_CELLS + 2) / TAG_CELLS / 2
    for tag in table.corners[:2]:
        inward = 1.0 if tag.x < middle else -1.0
        drawing.line((camera, (tag.x + inward * half, 0.0)), _ORANGE, 1.2, "5 4")
        drawing.rectangle(tag.x - half, 0.0, 2 * half, 0.008, 'fill="#000000"')
    for x in (-0.012, table.width):
        drawing.rectangle(x, 0.0, 0.012, wall, f'fill="{_WALL}" stroke="{FAINT}"')
    drawing.measure((0.012, 0.0), (0.012, wall), "")
    drawing.text(0.01, wall / 2, f"walls {1000 * wall:.0f}", FAINT, anchor="start", shift=(2.0, 4.0), size=12)
    box = table.obstacles[0]
    drawing.rectangle(0.30, 0.0, 2 * box.half_width, box.height, f'fill="{_BOX}" stroke="{FAINT}"')
    drawing.text(0.30 + box.half_width, box.height / 2, f"box, {1000 * box.height:.0f}", shift=(0.0, 4.0), size=12)
    x, height = 0.85, table.robots["hider"].height
    drawing.rectangle(x - BODY[0] / 2, 0.012, BODY[0], ROBOT_HEIGHT - 0.012, f'fill="rgb{HIDER_COLOR}" fill-opacity="0.6"')
    drawing.rectangle(x - table.robots["hider"].size / 2, height, table.robots["hider"].size, 0.008, 'fill="#000000"')
    drawing.line(((x + 0.07, height), (table.width + 0.14, height)), FAINT, 0.8, "3 3")
    drawing.text(
        table.width + 0.15, height, f"robots' tags {1000 * height:.0f}", FAINT, anchor="start", shift=(0.0, 4.0), size=12
    )
    drawing.line(((x + 0.07, MOUNT_HEIGHT), (table.width + 0.14, MOUNT_HEIGHT)), FAINT, 0.8, "3 3")
    level = f"robots' cameras {1000 * MOUNT_HEIGHT:.0f}"
    drawing.text(table.width + 0.15, MOUNT_HEIGHT, level, FAINT, anchor="start", shift=(0.0, 10.0), size=12)
    drawing.rectangle(middle - 0.03, hung.height, 0.06, 0.05, f'fill="{_BLUE}"')
    drawing.text(middle + 0.05, hung.height, _camera_text(hung), _BLUE, anchor="start", shift=(4.0, -2.0), size=12)
    drawing.measure(
        (middle - edge - 0.06, 0.0), (middle - edge - 0.06, hung.height), f"{1000 * hung.height:.0f}", shift=(-22.0, 4.0)
    )
    sight = "dashed: sight to the corner tags, over the walls"
    drawing.text(middle - edge - 0.02, hung.height, sight, _ORANGE, anchor="start", shift=(0.0, 18.0), size=12)
    drawing.text(table.corners[0].x, -0.03, f"tag {table.corners[0].id}", shift=(0.0, 18.0), size=12)
    drawing.text(table.corners[1].x, -0.03, f"tag {table.corners[1].id}", shift=(0.0, 18.0), size=12)
    return str(drawing)


def robot(table: Table) -> str:
    """Return one robot from above and from the side; mm."""
    mount = table.robots["hider"]
    drawing = Svg(-110.0, -115.0, 530.0, 95.0, 1.6, "A robot from above and from the side (mm)")
    length, width = 1000 * BODY[0], 1000 * BODY[1]
    color = f"rgb{HIDER_COLOR}"
    radius = 1000 * ROBOT_RADIUS
    drawing.circle(0.0, 0.0, radius, f'fill="{color}" fill-opacity="0.12" stroke="{color}" stroke-dasharray="6 4"')
    drawing.rectangle(-length / 2, -width / 2, length, width, f'fill="{color}" fill-opacity="0.35" stroke="{color}"')
    drawing.rectangle(length / 2 - 22, -45, 20, 90, 'fill="#374151"')
    _tag(drawing, mount.id, 1000 * mount.forward, 1000 * mount.left, 1000 * mount.size, mount.heading)
    drawing.arrow((radius, 0.0), (radius + 40, 0.0), color, 3.0)
    drawing.text(radius + 42, 0.0, "forward = the tag's arrow", anchor="start", shift=(2.0, 4.0), size=12)
    drawing.text(0.0, -radius, f"planned with a disc of radius {radius:g}", shift=(0.0, 18.0), size=12)
    drawing.text(0.0, -radius, "the tag's middle is over the middle of the axle", shift=(0.0, 50.0), size=12)
    drawing.text(0.0, -radius, f"tag {mount.id}, black square {1000 * mount.size:g}", shift=(0.0, 34.0), size=12)
    base = -60.0
    x = 385.0
    drawing.line(((x - 110, base), (x + 130, base)), FAINT, 1.5)
    drawing.circle(x, base + 16.0, 16.0, 'fill="#374151"')
    drawing.circle(x + 50.0, base + 6.0, 6.0, 'fill="#9ca3af"')
    body = 1000 * ROBOT_HEIGHT
    drawing.rectangle(x - length / 2, base + 12.0, length, body - 12.0, f'fill="{color}" fill-opacity="0.35" stroke="{color}"')
    lens = base + 1000 * MOUNT_HEIGHT
    drawing.rectangle(x + length / 2 - 22, lens - 12.0, 22.0, 24.0, 'fill="#374151"')
    drawing.line(((x + length / 2, lens), (x + 128, lens)), _BLUE, 1.2, "5 4")
    plate = base + 1000 * mount.height
    drawing.rectangle(x - 500 * mount.size, plate - 2.0, 1000 * mount.size, 2.0, 'fill="#000000"')
    drawing.measure((x + 105, base), (x + 105, lens), f"lens {1000 * MOUNT_HEIGHT:.0f}", shift=(32.0, 4.0))
    drawing.measure((x - 85, base), (x - 85, plate), f"tag {1000 * mount.height:.0f}", shift=(-30.0, 4.0))
    drawing.text(x, plate, "the tag's plate, level", shift=(0.0, -8.0), size=12)
    drawing.text(x, base, "in its own colour from the floor up, all around", FAINT, shift=(0.0, 20.0), size=12)
    drawing.text(x, base, "(green the hider, red the seeker); nothing else saturated", FAINT, shift=(0.0, 36.0), size=12)
    return str(drawing)


def wiring() -> str:
    """Return what is connected to what."""
    drawing = Svg(0.0, 0.0, 760.0, 330.0, 1.0, "Wiring: everything goes to one computer")
    places = {
        "computer": (290.0, 120.0, 190.0, 100.0, "computer", "Vantage, all services"),
        "camera": (290.0, 265.0, 190.0, 50.0, "camera above", "USB, 1280 x 720 at 30 /s"),
        "hider": (20.0, 95.0, 180.0, 130.0, "hider", ""),
        "seeker": (570.0, 95.0, 180.0, 130.0, "seeker", ""),
        "stop": (290.0, 15.0, 190.0, 55.0, "emergency stop", "cuts both robots' motors"),
    }
    colors = {"hider": f"rgb{HIDER_COLOR}", "seeker": f"rgb{SEEKER_COLOR}", "stop": "#b91c1c"}
    for name, (x, y, width, height, label, note) in places.items():
        color = colors.get(name, "#374151")
        drawing.rectangle(x, y, width, height, f'fill="{color}" fill-opacity="0.10" stroke="{color}" stroke-width="1.5"')
        drawing.text(x + width / 2, y + height, label, color, shift=(0.0, 20.0), bold=True)
        drawing.text(x + width / 2, y + height, note, FAINT, shift=(0.0, 38.0), size=12)
    for x in (35.0, 585.0):
        for y, label in ((160.0, "RGB-D camera"), (108.0, "microcontroller, wheels")):
            drawing.rectangle(x, y, 150.0, 34.0, f'fill="#ffffff" stroke="{FAINT}"')
            drawing.text(x + 75.0, y + 17.0, label, shift=(0.0, 5.0), size=12)
    for x, end in ((185.0, 290.0), (585.0, 480.0)):
        drawing.arrow((x, 178.0), (end, 178.0), _BLUE)
        drawing.text((x + end) / 2, 178.0, "USB 3", _BLUE, shift=(0.0, -6.0), size=12)
        drawing.line(((x, 132.0), (end, 132.0)), _ORANGE, 1.6, "6 4")
        drawing.text((x + end) / 2, 132.0, "serial line", _ORANGE, shift=(0.0, -6.0), size=12)
    drawing.arrow((385.0, 265.0), (385.0, 220.0), _BLUE)
    for x, end in ((290.0, 110.0), (480.0, 660.0)):
        drawing.line(((x, 42.0), (end, 42.0)), "#b91c1c", 1.6)
        drawing.arrow((end, 42.0), (end, 95.0), "#b91c1c")
    return str(drawing)


def heights_table(table: Table) -> str:
    """Return, as Markdown, how high a camera hangs for its angle of view, and how high walls may be then."""
    rows = ["| angle of view across | lens above the floor, at least | a robot's tag | walls, at most |", "|---|---|---|---|"]
    for degrees in VIEWS:
        hung = mounting(table, math.radians(degrees))
        rows.append(
            f"| {degrees:g}° | {hung.height:.2f} m | {hung.tag_pixels:.0f} px | {1000 * min(hung.wall, WALL_HEIGHT):.0f} mm |"
        )
    return "\n".join(rows)


def tags_table(table: Table) -> str:
    """Return, as Markdown, which tag goes where."""
    rows = ["| tag | size | where |", "|---|---|---|"]
    for name, mount in table.robots.items():
        place = f"on the {name}, {1000 * mount.height:g} mm above the floor, arrow forward"
        rows.append(f"| {mount.id} | {1000 * mount.size:g} mm | {place} |")
    for tag in table.obstacles:
        box = f"{2000 * tag.half_width:g} x {2000 * tag.half_depth:g} x {1000 * tag.height:g} mm"
        rows.append(f"| {tag.id} | {1000 * tag.size:g} mm | in the middle on top of a box of {box}, arrow along the first side |")
    for corner in table.corners:
        place = f"x = {1000 * corner.x:g} mm, y = {1000 * corner.y:g} mm"
        rows.append(f"| {corner.id} | {1000 * table.corner_size:g} mm | on the floor, centre at {place}, arrow along x |")
    return "\n".join(rows)


def drawings() -> dict[str, str]:
    """Return every picture of docs/table/, by name."""
    table = default_table()
    return {"plan.svg": plan(table), "side.svg": side(table), "robot.svg": robot(table), "wiring.svg": wiring()}


def with_tables(text: str) -> str:
    """Return the text of docs/table.md with its generated parts made anew.

    Raises:
        ValueError: the marks of a part are missing.
    """
    table = default_table()
    for name, part in (("heights", heights_table(table)), ("tags", tags_table(table))):
        begin, end = f"<!-- {name}, made by python -m vantage.setting_up.drawings -->\n\n", "\n\n<!-- end -->"
        head, first, rest = text.partition(begin)
        _, last, tail = rest.partition(end)
        if not first or not last:
            raise ValueError(f"docs/table.md must hold the marks {begin.strip()} and {end.strip()}")
        text = head + begin + part + end + tail
    return text


def main() -> None:
    """Renew the committed pictures and tables."""
    (DOCS / "table").mkdir(exist_ok=True)
    for name, text in drawings().items():
        (DOCS / "table" / name).write_text(text)
    page = DOCS / "table.md"
    page.write_text(with_tables(page.read_text()))
    print(f"renewed {DOCS / 'table'} and the tables in {page}")


def _tag(drawing: Svg, number: int, x: float, y: float, size: float, heading: float) -> None:
    half = size * (TAG_CELLS + 2) / TAG_CELLS / 2
    cosine, sine = math.cos(heading), math.sin(heading)
    square = [
        (x + cosine * a - sine * b, y + sine * a + cosine * b)
        for a, b in ((-half, -half), (half, -half), (half, half), (-half, half))
    ]
    drawing.polygon(square, 'fill="#ffffff"')
    drawing.cells(tag_cells(number)[1:-1, 1:-1] < 128, x, y, size, heading)


def _outline(box: Box) -> list[tuple[float, float]]:
    cosine, sine = math.cos(box.heading), math.sin(box.heading)
    return [
        (box.x + cosine * a - sine * b, box.y + sine * a + cosine * b)
        for a, b in (
            (-box.half_width, -box.half_depth),
            (box.half_width, -box.half_depth),
            (box.half_width, box.half_depth),
            (-box.half_width, box.half_depth),
        )
    ]


def _camera_text(hung: Mounting) -> str:
    return f"camera of {math.degrees(hung.view):.0f}° across, {hung.height:.2f} m above the floor"


if __name__ == "__main__":
    main()
