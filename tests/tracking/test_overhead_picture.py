from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from schemas import Box
from tests.tracking.overhead_scene import LAB, ROBOTS, Floats, lens, scene
from vantage.rehearsal.board_picture import BoardScene, draw_views
from vantage.rehearsal.overhead_light import Development, OverheadLook
from vantage.rehearsal.overhead_picture import OverheadScene, rehearsal_camera, table_of_layout
from vantage.rehearsal.overhead_rays import (
    BOX_SIDE,
    BOX_TOP,
    FLOOR,
    HIDER_SIDE,
    HIDER_TOP,
    OUTSIDE,
    WALL,
    WALL_TOP,
    color_at,
)
from vantage.tracking.errors import UnusableTable
from vantage.tracking.lens import charuco_board
from vantage.tracking.table import default_table
from vantage.tracking.tags import TagFinder
from vantage.world.layout import boxes_array

SHARP = OverheadLook(blur=0.0, noise=0.0, gradient=0.0, vignette=0.0, brightness=1.0)


def test_colors_are_those_of_a_march_down_every_ray() -> None:
    """Brute force: walk down each ray in steps of 0.2 mm and ask in which body it is."""
    boxes, camera = boxes_array(LAB), np.array([0.62, 0.57, 1.6])
    arena = np.array([1.2, 1.2, 0.3, 0.012])
    robots = np.array([[0.35, 0.30, 1.0, 0.0], [np.nan] * 4])
    body = np.array([[0.065, 0.12, 0.0, 0.0, 1.0, 0.0, 0.0, 0.13]] * 2)
    nothing = (np.empty((0, 6)), np.empty((0, 10, 10), np.uint8))
    cells = np.zeros((2, 10, 10), np.uint8)
    random = np.random.default_rng(4)

    def marched(x: float, y: float) -> int:
        heights = np.arange(0.32, 0.0, -0.0002)
        px, py = x + (camera[0] - x) * heights / camera[2], y + (camera[1] - y) * heights / camera[2]
        hits = [(-1.0, OUTSIDE if not (0 <= x <= 1.2 and 0 <= y <= 1.2) else FLOOR)]
        inside = (px >= 0) & (px <= 1.2) & (py >= 0) & (py <= 1.2)
        rim = (np.abs(px - 0.6) < 0.612) & (np.abs(py - 0.6) < 0.612) & ~inside & (heights <= 0.3)
        for solid, height, top, side in (
            (rim, 0.3, WALL_TOP, WALL),
            *(
                (
                    (np.abs(box[4] * (px - box[0]) + box[5] * (py - box[1])) < box[2])
                    & (np.abs(box[4] * (py - box[1]) - box[5] * (px - box[0])) < box[3])
                    & (heights <= box[6]),
                    box[6],
                    BOX_TOP,
                    BOX_SIDE,
                )
                for box in boxes
            ),
            ((np.hypot(px - robots[0, 0], py - robots[0, 1]) < 0.065) & (heights <= 0.12), 0.12, HIDER_TOP, HIDER_SIDE),
        ):
            if solid.any():
                first = heights[solid.argmax()]
                hits.append((first, top if first > height - 0.0003 else side))
        return max(hits)[1]

    points = np.concatenate((random.uniform(-0.3, 1.5, (300, 2)), random.uniform((0.2, 0.15), (0.5, 0.4), (200, 2))))
    found = [color_at(x, y, camera, arena, boxes, *nothing, robots, body, cells) for x, y in points]
    expected = [marched(x, y) for x, y in points]
    assert len(set(expected)) == 8
    # A march of 0.2 mm misses what a ray only grazes.
    assert np.mean([a == b for a, b in zip(found, expected, strict=True)]) > 0.99


def test_patches_make_the_same_picture_as_rendering_all_of_it() -> None:
    """Robots that stand in the background layer of a scene of its own would look just so: compare with a far larger patch."""
    small = scene()
    speeds = np.array([[0.2, 0.0, 1.0], [0.0, -0.1, 0.0]])
    whole = OverheadScene(small.table, rehearsal_camera(), small.look)
    whole._patches = lambda robots, speeds: [((0, 0, 1280, 720), [0, 1])]  # type: ignore[method-assign]
    for robots in (
        np.array([[0.33, 0.72, 0.4], [0.45, 0.70, 1.0]]),  # beside a box and each other
        np.array([[0.60, 1.14, 0.7], [0.20, 0.20, 1.0]]),  # at the picture's upper edge; in the open
    ):
        assert np.array_equal(small.render(robots, LAB, 5, 9, speeds), whole.render(robots, LAB, 5, 9, speeds))


def test_tags_are_found_where_they_truly_are_without_bias() -> None:
    finder, random = TagFinder(), np.random.default_rng(1)
    errors = []
    for frame in range(12):
        robots = np.column_stack((random.uniform(0.15, 1.05, (2, 2)), random.uniform(-3, 3, 2)))
        if math.dist(robots[0, :2], robots[1, :2]) > 0.16:
            truth = scene().true_corners(robots, ())
            shown = scene().render(robots, (), 1, frame)
            found = {tag.id: tag.corners for tag in finder.find(shown, (0, 0, 1280, 720), half=True)}
            errors += [found[tag] - truth[tag] for tag in (0, 1)]
    assert len(errors) >= 16
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.02
    assert np.sqrt(np.mean(np.square(errors))) < 0.12


def test_motion_blur_lies_along_the_way() -> None:
    """A robot at 1 m/s during 20 ms: its left and right rims smear over 20 mm, its upper and lower ones do not."""
    look = OverheadLook(**{**SHARP.__dict__, "exposure": 0.02})
    shown = OverheadScene(default_table(), rehearsal_camera(), look)
    robots = np.array([[0.6, 0.6, 0.0], [np.nan] * 3])

    def rims(speed: float) -> tuple[int, int]:
        green = shown.render(robots, (), 1, 0, np.array([[speed, 0.0, 0.0], [0.0] * 3])).astype(int)[..., 1]
        column, row = shown.camera.project(np.array([[0.6, 0.6, 0.12]]))[0].round().astype(int)
        across, down = green[row, column + 22 : column + 75], green[row - 60 : row - 22, column]
        mixed = [int(((line > 125) & (line < 185)).sum()) for line in (across, down)]
        return mixed[0], mixed[1]

    still, moving = rims(0.0), rims(1.0)
    assert still[0] <= 2 and still[1] <= 2
    assert 8 <= moving[0] <= 13 and moving[1] <= 3


def test_pictures_depend_on_seed_and_frame_alone() -> None:
    first = scene().render(ROBOTS, LAB, 7, 3)
    assert np.array_equal(first, scene().render(ROBOTS, LAB, 7, 3))
    other = scene().render(ROBOTS, LAB, 7, 4).astype(int)
    assert not np.array_equal(first, other)
    assert np.std(first - other) == pytest.approx(3.0 * math.sqrt(2), rel=0.1)
    assert not np.array_equal(first, scene().render(ROBOTS, LAB, 8, 3))


def test_light_falls_off_and_lamps_shine_as_set() -> None:
    grey = np.full((72, 128, 3), 100, np.float32)

    def developed(look: OverheadLook) -> Floats:
        development = Development(128, 72, look)
        light = np.empty(grey.shape, np.int16)
        development.develop(grey, (0, 0, 128, 72), light)
        return development.read_out(light, 1, 0).astype(np.float64)[..., 0]

    even = developed(SHARP)
    assert even == pytest.approx(np.full((72, 128), 100.0))
    uneven = developed(OverheadLook(noise=0.0, gradient=0.3, vignette=0.4, brightness=1.0))
    assert uneven[0, 127] > uneven[0, 0] and uneven[36, 64] > uneven[0, 127]
    lamp = developed(OverheadLook(**{**SHARP.__dict__, "glare_column": 100, "glare_row": 20, "glare_radius": 10}))
    assert lamp[20, 100] == 255 and lamp[60, 20] == 100


def test_robots_outside_the_picture_or_absent_are_no_error() -> None:
    away = np.array([[5.0, 5.0, 0.0], [np.nan] * 3])
    assert np.array_equal(scene().render(away, LAB, 7, 0), scene().render(np.full((2, 3), np.nan), LAB, 7, 0))
    edge = scene().render(np.array([[0.6, 1.36, 0.0], [1.68, 0.6, 0.0]]), LAB, 7, 0)
    assert not np.array_equal(edge, scene().render(away, LAB, 7, 0))


def test_the_table_of_a_layout_carries_its_boxes() -> None:
    boxes = (Box(x=0.3, y=0.3, half_width=0.1, half_depth=0.05, height=0.15), Box(x=0.8, y=0.8, half_width=0.06, half_depth=0.06))
    table = table_of_layout(default_table(), boxes)
    assert [(tag.id, tag.half_width, tag.height) for tag in table.obstacles] == [(10, 0.1, 0.15), (11, 0.06, 0.2)]
    with pytest.raises(UnusableTable, match="does not fit"):
        table_of_layout(default_table(), (Box(x=0.3, y=0.3, half_width=0.1, half_depth=0.02),))


def test_a_rendered_board_has_its_corners_where_the_lens_puts_them() -> None:
    board_scene = BoardScene(lens(), look=OverheadLook(noise=1.0))
    rotation, translation = draw_views(1, board_scene.board, 2)[0]
    shown = cv2.cvtColor(board_scene.render(rotation, translation, 1, 0), cv2.COLOR_RGB2GRAY)
    places = charuco_board(board_scene.board).getChessboardCorners()
    matrix, distortion = np.array(lens().matrix).reshape(3, 3), np.array(lens().distortion)
    truth = cv2.projectPoints(places, rotation, translation, matrix, distortion)[0].reshape(-1, 2)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.001)
    found = cv2.cornerSubPix(shown, truth.astype(np.float32).reshape(-1, 1, 2).copy(), (4, 4), (-1, -1), criteria).reshape(-1, 2)
    assert np.abs(found - truth).max() < 0.15
    assert np.abs((found - truth).mean(axis=0)).max() < 0.03
