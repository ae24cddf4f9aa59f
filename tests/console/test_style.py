"""The theme's colours can be read by everybody: WCAG 2.2, contrast of at least 4.5 : 1 for text, in both themes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from vantage.perception.palette import DANGER

PAGE = Path(__file__).parents[2] / "services" / "console" / "page"
TEXT_ON = [
    *((text, ground) for text in ("text", "quiet", "ok", "warn", "bad") for ground in ("ground", "panel", "raised")),
    ("on-accent", "accent"),
    *(("text", "floor"), ("quiet", "floor")),
]
PARTS_ON = [("accent", "floor"), ("plan", "floor"), ("accent", "ground"), ("box", "floor")]
"""What is not text needs 3 : 1 (a box also has an outline in the colour of text)."""


def themes() -> dict[str, dict[str, str]]:
    style = (PAGE / "style.css").read_text()
    blocks = re.findall(r':root\[data-theme="(dark|light)"\] \{(.*?)\}', style, re.DOTALL)
    return {name: dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", block)) for name, block in blocks if "--ground" in block}


def luminance(color: str) -> float:
    parts = (int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_text_can_be_read(theme: str) -> None:
    colors = themes()[theme]
    poor = {pair: round(contrast(colors[pair[0]], colors[pair[1]]), 2) for pair in TEXT_ON}
    assert {pair: value for pair, value in poor.items() if value < 4.5} == {}


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_what_is_drawn_can_be_told_from_the_floor(theme: str) -> None:
    colors = themes()[theme]
    assert {pair for pair in PARTS_ON if contrast(colors[pair[0]], colors[pair[1]]) < (2.0 if pair[0] == "box" else 3.0)} == set()


def test_danger_has_the_colours_that_value_maps_have_everywhere() -> None:
    table = re.search(r"const DANGER = (\[.*\]);", (PAGE / "scales.js").read_text())
    assert table and json.loads(table[1]) == DANGER.tolist()


def test_the_page_is_self_contained() -> None:
    for file in PAGE.iterdir():
        text = file.read_text()
        assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)|@import|innerHTML|\beval\(", text), file.name
        assert text.count("\n") <= 300, f"{file.name} does too much"
    markup = (PAGE / "index.html").read_text()
    assert not re.search(r"\son\w+=|\sstyle=|<style|<script(?![^>]*\ssrc=)", markup), "the policy forbids inline script and style"
