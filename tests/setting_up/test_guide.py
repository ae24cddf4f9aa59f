"""The guide of a lab: its drawings and tables are of this table, what it quotes is said, and its heights are true."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import msgspec
import numpy as np
import pytest

from vantage import cli
from vantage.setting_up import drawings
from vantage.setting_up.optics import SLACK, WALL_THICKNESS, highest_wall, mounting
from vantage.setting_up.picture_check import SCALE_TOLERANCE, SMALLEST_TAG
from vantage.setting_up.sheets import RULER
from vantage.tracking.calibration import GREATEST_ARENA_RESIDUAL, OLDEST_DAYS
from vantage.tracking.table import CornerTag, default_table

ROOT = Path(__file__).resolve().parents[2]
GUIDE = (ROOT / "docs/table.md").read_text()
SPEAKERS = ("vantage/tracking", "vantage/setting_up", "services/tracker", "services/robot")


def test_the_committed_drawings_are_up_to_date() -> None:
    made = drawings.drawings()
    assert sorted(path.name for path in (ROOT / "docs/table").iterdir()) == sorted(made)
    for name, text in made.items():
        assert (ROOT / "docs/table" / name).read_text() == text, "run python -m vantage.setting_up.drawings"


def test_the_committed_tables_are_up_to_date() -> None:
    assert drawings.with_tables(GUIDE) == GUIDE, "run python -m vantage.setting_up.drawings"
    with pytest.raises(ValueError, match="must hold the marks"):
        drawings.with_tables("a page without marks")


def test_drawings_are_svg_and_everything_is_inside() -> None:
    for name, text in drawings.drawings().items():
        picture = ElementTree.fromstring(text)
        width, height = float(picture.attrib["width"]), float(picture.attrib["height"])
        for part in picture.iter():
            points = [pair.split(",") for pair in part.attrib.get("points", "").split()]
            if "x" in part.attrib:
                points.append([part.attrib["x"], part.attrib["y"]])
            for x, y in points:
                assert -1.0 <= float(x) <= width + 1.0 and -1.0 <= float(y) <= height + 1.0, (name, part.attrib)


def test_drawings_follow_the_table() -> None:
    table = default_table()
    moved = msgspec.structs.replace(table, corners=(CornerTag(id=55, x=-0.31, y=0.2), *table.corners[1:]))
    for draw in (drawings.plan, drawings.side):
        assert draw(moved) != draw(table)
    assert "tag 55" in drawings.plan(moved) and "x -310, y 200" in drawings.plan(moved)
    assert "| 55 |" in drawings.tags_table(moved)


def test_what_services_are_quoted_with_is_what_they_say() -> None:
    """Each symptom of the table stands in the source of a service, but for what is filled in there."""
    section = GUIDE.partition("## What goes wrong")[2].partition("\n## ")[0]
    symptoms = re.findall(r"^\| `([^`]+)` \|", section, re.MULTILINE)
    assert len(symptoms) >= 20
    source = "\n".join(path.read_text() for folder in SPEAKERS for path in (ROOT / folder).glob("*.py"))
    joined = re.sub(r'"\s*\n\s*f?"', "", source)
    for symptom in symptoms:
        assert symptom in joined, f"nobody says {symptom!r} any more"


def test_figures_of_the_text_are_those_of_the_code() -> None:
    flat = " ".join(GUIDE.split())
    assert f"older than {OLDEST_DAYS} days or whose residual is above {GREATEST_ARENA_RESIDUAL:g} mm" in flat
    assert f"A tag should be {SMALLEST_TAG:g} px wide" in flat
    assert f"no size is off by {100 * SCALE_TOLERANCE:g} %" in flat
    assert f"{RULER:g} mm to half a millimetre" in flat


def test_every_command_of_the_guide_exists_and_its_options_too() -> None:
    quoted = re.findall(r"`(vantage [a-z][^`]*)`", GUIDE) + re.findall(r"^ *(vantage [a-z].*)$", GUIDE, re.MULTILINE)
    assert len(quoted) > 15
    for text in quoted:
        assert cli.find(text.split()[1:]) is not None, text
    for option in ("--source", "--table", "--robot", "--hider", "--seeker", "--grey", "--to"):
        assert option in GUIDE
    for target in re.findall(r"\]\(([^)#]+)\)", GUIDE):
        assert (ROOT / "docs" / target).exists(), target


@pytest.mark.parametrize("degrees", drawings.VIEWS)
def test_a_camera_that_hangs_as_told_sees_all_of_it(degrees: float) -> None:
    """Brute force: corners of all tags, and of robots' tags at the walls, through a pinhole; 5 % lower they are cut off."""
    table = default_table()
    hung = mounting(table, math.radians(degrees))

    def outermost(height: float) -> float:
        half = table.corner_size * 10 / 8 / 2
        points = [
            (tag.x - 0.6 + a * half, tag.y - 0.6 + b * half, 0.0) for tag in table.corners for a in (-1, 1) for b in (-1, 1)
        ]
        reach = 0.6 - 0.065 + 0.0375
        points += [(a * reach, b * reach, 0.13) for a in (-1, 1) for b in (-1, 1)]
        focal = 640.0 / math.tan(math.radians(degrees) / 2)
        return max(max(abs(x) * focal / (height - z) / 640.0, abs(y) * focal / (height - z) / 360.0) for x, y, z in points)

    assert outermost(hung.height) == pytest.approx(1.0 - SLACK, abs=1e-6)
    assert outermost(0.95 * hung.height) > 1.0 - SLACK
    assert hung.tag_pixels >= SMALLEST_TAG


@pytest.mark.parametrize("height", [1.2, 1.6, 2.5])
def test_walls_as_high_as_told_hide_no_corner_tag(height: float) -> None:
    """Brute force: rays from the camera to many points of each tag's sheet, against each wall as a thick plate."""
    table = default_table()
    wall = highest_wall(table, height)

    def hidden(wall_height: float) -> bool:
        half = table.corner_size * 10 / 8 / 2
        for tag in table.corners:
            for a in np.linspace(-half, half, 9):
                for b in np.linspace(-half, half, 9):
                    target = np.array([tag.x + a - 0.6, tag.y + b - 0.6])
                    for share in np.linspace(0.0, 1.0, 400):
                        x, y = share * target
                        inside_x, inside_y = abs(x) <= 0.6, abs(y) <= 0.6
                        in_wall = (0.6 < abs(x) <= 0.6 + WALL_THICKNESS and inside_y) or (
                            0.6 < abs(y) <= 0.6 + WALL_THICKNESS and inside_x
                        )
                        if in_wall and height * (1.0 - share) < wall_height - 1e-9:
                            return True
        return False

    assert not hidden(wall)
    assert hidden(wall + 0.02)
