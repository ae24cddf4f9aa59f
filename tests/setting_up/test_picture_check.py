"""What `vantage table check` finds in a picture: each fault is put into the scene, and only its line may change."""

from __future__ import annotations

import math

import cv2
import msgspec
import numpy as np
import pytest

from tests.setting_up.table_scene import ROBOTS, calibration_of_today, picture
from vantage.rehearsal.overhead_light import OverheadLook
from vantage.rehearsal.overhead_picture import rehearsal_camera
from vantage.setting_up.annotation import Canvas
from vantage.setting_up.picture_check import check_picture, corner_errors, edge_width, find_tags
from vantage.setting_up.verdict import Verdict
from vantage.tracking.overhead_camera import OverheadCamera
from vantage.tracking.table import CornerTag, Table, default_table
from vantage.tracking.tags import FoundTag


def troubles(shown: np.ndarray, table: Table | None = None) -> dict[str, Verdict]:
    verdicts, annotated = check_picture(shown, table or default_table(), calibration_of_today())
    assert annotated.shape == shown.shape
    return {verdict.what: verdict for verdict in verdicts if not verdict.ok}


def test_a_good_table_has_no_trouble_and_robots_are_where_they_are() -> None:
    verdicts, annotated = check_picture(picture(), default_table(), calibration_of_today())
    assert all(verdict.ok for verdict in verdicts), verdicts
    by_name = {verdict.what: verdict.found for verdict in verdicts}
    for name, (x, y, heading) in zip(("hider", "seeker"), ROBOTS, strict=True):
        assert by_name[name] == f"x {1000 * x:.0f} mm, y {1000 * y:.0f} mm, heading {round(math.degrees(heading))}°"
    assert not np.array_equal(annotated, picture())


@pytest.mark.parametrize(
    ("look", "line", "told"),
    [
        (OverheadLook(brightness=0.22, noise=1.0), "light", "too dark"),
        (OverheadLook(glare_column=640.0, glare_row=200.0, glare_radius=110.0), "light", "glare"),
        (OverheadLook(blur=1.6), "sharpness", "focus"),
    ],
)
def test_light_and_focus(look: OverheadLook, line: str, told: str) -> None:
    found = troubles(picture(look=look))
    assert line in found
    assert told in found[line].remedy


def test_covered_and_doubled_and_strange_tags() -> None:
    found = troubles(picture(covered=frozenset({0, 22, 11})))
    assert "missing: 0 (hider)" in found["robots' tags"].found
    assert "missing: 22" in found["corner tags"].found
    assert "missing: 11" in found["boxes' tags"].found
    doubled = troubles(picture(strays=(CornerTag(id=20, x=0.6, y=0.1), CornerTag(id=99, x=0.2, y=0.1))))
    assert list(doubled) == ["tags seen twice", "calibration"]
    assert doubled["tags seen twice"].found == "20"


def test_a_corner_tag_or_the_camera_moved() -> None:
    table = default_table()
    moved = (msgspec.structs.replace(table.corners[2], y=table.corners[2].y - 0.02), *table.corners[:2], table.corners[3])
    found = troubles(picture(), msgspec.structs.replace(table, corners=moved))
    assert list(found) == ["calibration"]
    assert "worst 22" in found["calibration"].found
    assert "10.0 mm" in found["calibration"].found


@pytest.mark.parametrize(
    "change",
    [{"size": 0.057}, {"size": 0.063}, {"height": 0.07}],
    ids=["printed too small", "printed too large", "mounted lower"],
)
def test_a_tag_of_another_size_or_height_than_the_file_says(change: dict[str, float]) -> None:
    table = default_table()
    seeker = msgspec.structs.replace(table.robots["seeker"], **change)
    found = troubles(picture(), msgspec.structs.replace(table, robots={**table.robots, "seeker": seeker}))
    assert list(found) == ["seeker"]
    assert "measure its black square and its height" in found["seeker"].remedy


def test_corner_errors_are_the_distances_that_were_put_in() -> None:
    table, camera = default_table(), OverheadCamera(rehearsal_camera())
    shift = (0.012, -0.005)
    tags = []
    for tag in table.corners:
        half = table.corner_size / 2
        around = [(-half, -half), (half, -half), (half, half), (-half, half)]
        places = np.array([(tag.x + dx + shift[0], tag.y + dy + shift[1], 0.0) for dx, dy in around])
        tags.append(FoundTag(tag.id, camera.project(places), 80.0))
    for errors in corner_errors(camera, tags, table).values():
        assert errors == pytest.approx(math.hypot(*shift), abs=1e-6)


@pytest.mark.parametrize("sigma", [0.8, 1.2, 1.8])
@pytest.mark.parametrize("turned", [0.0, 23.0])
def test_the_width_of_edges_is_that_of_the_blur(sigma: float, turned: float) -> None:
    """A step blurred by a Gaussian takes 2.563 sigma from 10 to 90 %: here an ideal square, drawn 8 times finer."""
    size, fine = 120, 8
    canvas = np.full((size * fine, size * fine), 220, np.uint8)
    angle = math.radians(turned)
    square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * 32.0
    corners = square @ np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]) + 60.0
    cv2.fillPoly(canvas, [np.round(corners * fine).astype(np.int32)], 20)
    blurred = cv2.GaussianBlur(canvas.astype(np.float32), (0, 0), sigma * fine)
    picture_of_it = np.round(cv2.resize(blurred, (size, size), interpolation=cv2.INTER_AREA)).astype(np.uint8)
    width, contrast = edge_width(picture_of_it, FoundTag(0, corners - 0.5, 80.0))
    # A pixel's own width and the interpolation between pixels add a little blur.
    true = 2.563 * math.sqrt(sigma**2 + 1 / 12 + 1 / 6)
    assert width == pytest.approx(true, rel=0.08)
    assert contrast == pytest.approx(200.0, abs=6.0)


def test_every_tag_of_a_picture_is_found() -> None:
    assert sorted(tag.id for tag in find_tags(picture())) == [0, 1, 10, 11, 12, 20, 21, 22, 23]


def test_what_is_drawn_lies_where_the_camera_sees_it() -> None:
    """The border and a goal, found again in an annotated black picture."""
    camera = OverheadCamera(rehearsal_camera())
    canvas = Canvas(np.zeros((720, 1280, 3), np.uint8), camera)
    canvas.arena(default_table())
    for place in ((0.0, 0.7), (1.2, 0.3), (0.5, 1.2), (0.6, 0.6), (1.1, 0.1)):
        u, v = camera.project(np.array([[*place, 0.0]]))[0]
        assert canvas.picture[round(float(v)) - 1 : round(float(v)) + 2, round(float(u)) - 1 : round(float(u)) + 2].max() > 150
    u, v = camera.project(np.array([[0.55, 0.65, 0.0]]))[0]
    assert canvas.picture[round(float(v)), round(float(u))].max() == 0


def test_a_picture_that_shows_no_table_at_all() -> None:
    found = troubles(np.full((720, 1280, 3), 120, np.uint8))
    assert set(found) == {"corner tags", "robots' tags", "boxes' tags", "calibration"}
