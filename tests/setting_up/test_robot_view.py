"""What a robot's camera sees, judged on rendered pictures as planner and seeker get them."""

from __future__ import annotations

import numpy as np
import pytest

from vantage.perception.scan import COLOR_DISTANCE, DARKEST
from vantage.rehearsal.rgbd_picture import RgbdCamera, render_rgbd
from vantage.setting_up.robot_view import check_robot_view, colored_pixels
from vantage.tracking.rgbd import prepare
from vantage.world.arena import HIDER, HIDER_COLOR, SEEKER, SEEKER_COLOR
from vantage.world.layout import LAB, boxes_array


def published(other: tuple[float, float] | None, color: int = SEEKER) -> tuple[np.ndarray, np.ndarray]:
    camera = RgbdCamera()
    depth, colors = render_rgbd(camera, boxes_array(LAB), (0.2, 0.5, 0.0), other, color, 1, 2, HIDER)
    level, corrected, _ = prepare(depth, colors, camera.geometry)
    return corrected, level


def test_a_seeker_in_sight_is_outlined_and_nothing_is_wrong() -> None:
    color, depth = published((0.55, 0.5))
    verdicts, shown = check_robot_view("hider", color, depth, 0.1)
    assert all(verdict.ok for verdict in verdicts), verdicts
    assert "taken for the seeker" in verdicts[2].found and " 0.0 % taken" not in verdicts[2].found
    assert shown.shape == (4 * color.shape[0], 8 * color.shape[1], 3)


def test_something_in_the_robots_own_colour_is_told() -> None:
    color, depth = published((0.55, 0.5), HIDER)
    verdicts, _ = check_robot_view("hider", color, depth, 30.0)
    assert [verdict.what for verdict in verdicts if not verdict.ok] == ["hider's colours"]
    assert "30 s ago" in verdicts[0].found


def test_darkness_and_holes_are_told() -> None:
    color, depth = published(None)
    holey = depth.copy()
    holey[:, : depth.shape[1] // 2] = 0
    verdicts, _ = check_robot_view("hider", color // 6, holey, 0.0)
    assert [verdict.what for verdict in verdicts if not verdict.ok] == ["hider's camera", "hider's depth"]


@pytest.mark.parametrize(("robot", "canonical"), [(HIDER, HIDER_COLOR), (SEEKER, SEEKER_COLOR)])
def test_the_filter_is_that_of_perception(robot: int, canonical: tuple[int, int, int]) -> None:
    """Brute force over random colours: chromaticity nearer to the canonical one than the limit, and bright enough."""
    colors = np.random.default_rng(3).integers(0, 256, (40, 50, 3)).astype(np.uint8)
    colors[0, 0] = canonical
    taken = colored_pixels(colors, robot)
    target = np.array(canonical) / sum(canonical)
    for row in range(40):
        for column in range(50):
            values = colors[row, column].astype(float)
            near = values.sum() > 0 and np.linalg.norm(values / values.sum() - target) < COLOR_DISTANCE
            assert taken[row, column] == (near and values.sum() >= DARKEST)
    assert taken[0, 0]
