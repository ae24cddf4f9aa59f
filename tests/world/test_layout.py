"""Layouts: gaps as promised, the same for the same seed, and refusals that say what is wrong."""

from __future__ import annotations

import json
import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas import Box, Layout
from tests.world import reference
from vantage.errors import UserError
from vantage.world import arena
from vantage.world.layout import (
    LAB,
    MINIMUM_GAP,
    RANDOM_HALF_SIDE_MAXIMUM,
    RANDOM_HALF_SIDE_MINIMUM,
    ImpossibleLayout,
    box_gap,
    boxes_array,
    boxes_of,
    draw_boxes,
    make_layout,
    wall_gap,
)
from vantage.world.motion import line_of_sight

SIZE = arena.ARENA_SIZE
seeds = st.integers(0, 2**62)


def assert_gaps(obstacles: tuple[Box, ...]) -> None:
    boxes = boxes_array(obstacles)
    outlines = [reference.outline(box) for box in boxes]
    for first, points in enumerate(outlines):
        assert points.min() >= MINIMUM_GAP - 1e-9
        assert points.max() <= SIZE - MINIMUM_GAP + 1e-9
        for second in range(first):
            apart = np.hypot(*(points[:, None] - outlines[second][None]).transpose(2, 0, 1)).min()
            assert apart >= MINIMUM_GAP - 1e-9
            assert box_gap(boxes, first, second) == pytest.approx(apart, abs=1e-3)
        assert wall_gap(boxes, first, SIZE, SIZE) == pytest.approx(min(points.min(), SIZE - points.max()), abs=1e-9)


@given(seed=seeds)
@settings(max_examples=30, deadline=None)
def test_random_boxes_keep_their_sizes_and_gaps(seed: int) -> None:
    obstacles = make_layout("random", seed)
    assert len(obstacles) == 3
    for box in obstacles:
        assert min(box.half_width, box.half_depth) >= RANDOM_HALF_SIDE_MINIMUM
        assert max(box.half_width, box.half_depth) <= RANDOM_HALF_SIDE_MAXIMUM
        assert box.height == arena.BOX_HEIGHT
    assert_gaps(obstacles)


def test_lab_keeps_the_gaps_and_offers_a_hiding_place_behind_each_box() -> None:
    assert_gaps(LAB)
    for box in LAB:
        alone = boxes_array((box,))
        directions = np.stack([(math.cos(a), math.sin(a)) for a in np.linspace(0, 2 * math.pi, 36)])
        around = [(box.x + 0.2 * dx, box.y + 0.2 * dy) for dx, dy in directions]
        hidden = [not line_of_sight(alone, *around[i], *around[(i + 18) % 36]) for i in range(36)]
        assert all(hidden)


@given(seed=seeds)
@settings(max_examples=50, deadline=None)
def test_a_seed_gives_one_layout_to_the_last_bit_in_kernels_and_messages(seed: int) -> None:
    obstacles = make_layout("random", seed)
    assert obstacles == make_layout("random", seed)
    assert obstacles != make_layout("random", seed + 1)
    boxes = np.empty((3, 7))
    assert draw_boxes(seed, SIZE, SIZE, boxes, np.empty(3))
    layout = msgspec.msgpack.decode(msgspec.msgpack.encode(Layout(stamp=0, obstacles=obstacles)), type=Layout)
    np.testing.assert_array_equal(boxes, boxes_of(layout))


def test_random_layouts_use_the_whole_arena() -> None:
    places = np.array([(box.x, box.y) for seed in range(300) for box in make_layout("random", seed)])
    counts = np.histogram2d(*places.T, bins=3, range=[[0.2, 1.0]] * 2)[0]
    # Three boxes with wide gaps leave the middle free more often than a corner, but not always.
    assert counts.min() > 0.2 * counts.max()


def test_too_many_boxes_are_given_up() -> None:
    assert not draw_boxes(1, 0.5, 0.5, np.empty((3, 7)), np.empty(3))


@pytest.mark.parametrize("suffix", [".json", ".msgpack"])
def test_a_layout_file_is_read(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"layout{suffix}"
    content = {"obstacles": LAB}
    path.write_bytes(msgspec.json.encode(content) if suffix == ".json" else msgspec.msgpack.encode(content))
    assert make_layout(str(path), 5) == LAB
    path.write_bytes(msgspec.json.encode({"obstacles": []}) if suffix == ".json" else msgspec.msgpack.encode({"obstacles": []}))
    assert make_layout(str(path), 5) == ()


def test_no_obstacles_are_an_empty_array() -> None:
    assert boxes_of(Layout(stamp=0)).shape == (0, 7)


_BOX = {"x": 0.6, "y": 0.6, "half_width": 0.1, "half_depth": 0.1}


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"{obstacles", "is not JSON"),
        (b"\xff\xfe\x00", "is not JSON"),
        (b"[]", "does not describe boxes.*Expected `object`"),
        (b"{}", "missing required field `obstacles`"),
        (json.dumps({"obstacle": [_BOX]}).encode(), "does not describe boxes"),
        (json.dumps({"obstacles": [{**_BOX, "x": "left"}]}).encode(), r"obstacles\[0\].x|obstacles\[...\].x"),
        (json.dumps({"obstacles": [{**_BOX, "x": math.nan}]}).encode(), "is not JSON"),
        (json.dumps({"obstacles": [{**_BOX, "half_width": -1.0}]}).encode(), "half_width"),
        (json.dumps({"obstacles": [_BOX, {**_BOX, "x": 0.05}]}).encode(), "obstacle 1 at .* overlaps a wall"),
        (json.dumps({"obstacles": [{**_BOX, "half_width": 0.6, "half_depth": 0.6}]}).encode(), "leave no free place"),
        (json.dumps({"obstacles": [{**_BOX, "height": 0.0}]}).encode(), "has no height"),
        (json.dumps({"obstacles": [_BOX] * 65}).encode(), "does not describe boxes"),
    ],
)
def test_an_impossible_file_is_refused_by_name(tmp_path: Path, content: bytes, text: str) -> None:
    path = tmp_path / "broken.json"
    path.write_bytes(content)
    with pytest.raises(ImpossibleLayout, match=text) as caught:
        make_layout(str(path), 0)
    assert "broken.json" in str(caught.value)


def test_nan_in_messagepack_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "nan.msgpack"
    path.write_bytes(msgspec.msgpack.encode({"obstacles": [{**_BOX, "y": math.nan}]}))
    with pytest.raises(ImpossibleLayout, match=r"obstacles\[0\]\.y"):
        make_layout(str(path), 0)
    with pytest.raises(ImpossibleLayout, match=r"no such file.*`lab`, `random`"):
        make_layout(str(tmp_path / "absent.json"), 0)
    with pytest.raises(ImpossibleLayout, match="cannot be read"):
        make_layout(str(tmp_path), 0)
    with pytest.raises(ImpossibleLayout, match="cannot be read"):
        make_layout("", 0)
    with pytest.raises(ImpossibleLayout, match="cannot be read"):
        make_layout("a\0b", 0)
    (tmp_path / "large.json").write_bytes(b" " * 1_000_001)
    with pytest.raises(ImpossibleLayout, match="larger than"):
        make_layout(str(tmp_path / "large.json"), 0)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("deep.json", b'{"obstacles":[{"x":0.5,"y":0.5,"half_width":0.1,"half_depth":0.1,"more":' + b"[" * 10_000),
        ("deep.msgpack", b"\x81\xa9obstacles\x91\x81\xa4more" + b"\x91" * 10_000),
        ("many.msgpack", b"\x81\xa9obstacles\xdd" + (10**9).to_bytes(4, "big")),
        ("many.json", b'{"obstacles":[' + b",".join([b'{"x":0,"y":0,"half_width":1,"half_depth":1}'] * 20_000) + b"]}"),
        ("large.json", b" " * 1_000_001),
    ],
)
def test_a_layout_file_of_absurd_depth_or_size_is_refused_in_one_line(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ImpossibleLayout, match=name) as refused:
        make_layout(str(tmp_path / name), 1)
    assert isinstance(refused.value, UserError) and "\n" not in str(refused.value)
