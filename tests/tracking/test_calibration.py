from __future__ import annotations

import datetime
import json
from pathlib import Path

import cv2
import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from tests.tracking.overhead_scene import TODAY, Picture, calibration, copied, covered, lens, picture
from vantage.rehearsal.board_picture import BoardScene, draw_views
from vantage.rehearsal.overhead_light import OverheadLook
from vantage.rehearsal.overhead_picture import OverheadScene, rehearsal_camera
from vantage.tracking.calibration import Calibration, calibrate_arena, calibrate_lens, load_calibration, save_calibration
from vantage.tracking.errors import CalibrationFailed, UnusableCalibration
from vantage.tracking.lens import Lens
from vantage.tracking.overhead_camera import OverheadCamera
from vantage.tracking.table import CornerTag, default_table

NOBODY = np.full((2, 3), np.nan)


def greatest_error(found: Calibration, truth: Calibration, height: float) -> float:
    """Greatest distance on a plane of the arena between what two calibrations make of the same pixels, mm."""
    x, y = np.meshgrid(np.linspace(0.05, 1.15, 12), np.linspace(0.05, 1.15, 12))
    points = np.column_stack((x.ravel(), y.ravel(), np.full(x.size, height)))
    back, _ = OverheadCamera(found).on_plane(OverheadCamera(truth).project(points), height)
    return 1000 * float(np.linalg.norm(back - points[:, :2], axis=1).max())


@pytest.fixture(scope="module")
def board_pictures() -> list[Picture]:
    scene = BoardScene(lens(), look=OverheadLook(blur=0.9, noise=3.0))
    return [scene.render(*view, seed=1, frame=index) for index, view in enumerate(draw_views(12, scene.board, 5))]


def test_the_whole_procedure_finds_the_camera_from_rendered_pictures(board_pictures: list[Picture]) -> None:
    result = calibrate_lens(board_pictures)
    assert result.lens.residual < 0.15 and result.lens.views == 12 and result.refused == ()
    found = calibrate_arena(picture(NOBODY, ()), default_table(), result.lens, TODAY, "test")
    assert (found.date, found.made_with, found.lens_residual) == (TODAY, "test", result.lens.residual)
    assert found.arena_residual < 0.5
    for height in (0.0, 0.13, 0.2):
        assert greatest_error(found, calibration(), height) < 1.0
    assert OverheadCamera(found).centre == pytest.approx((0.6, 0.6, 1.6), abs=0.005)


def test_pictures_of_no_use_are_refused_with_the_reason(board_pictures: list[Picture]) -> None:
    blank = np.full_like(board_pictures[0], 90)
    half = blank.copy()
    half[:, :200] = board_pictures[1][:, :200]
    small = cv2.resize(board_pictures[2], (640, 360))
    result = calibrate_lens([*board_pictures[:9], blank, board_pictures[0], small])
    reasons = dict(result.refused)
    assert result.lens.views == 9
    assert "shows no board" in reasons[9]
    assert "just as picture 0 does" in reasons[10]
    assert "640 x 360" in reasons[11]
    with pytest.raises(CalibrationFailed, match=r"1 good pictures of the board, 8 are needed.*shows no board"):
        calibrate_lens([board_pictures[0], blank])
    with pytest.raises(CalibrationFailed, match="no pictures"):
        calibrate_lens([])


def test_a_board_that_was_bent_in_one_picture_is_left_out(board_pictures: list[Picture]) -> None:
    rows, columns = np.mgrid[0:720, 0:1280].astype(np.float32)
    bent = cv2.remap(board_pictures[3], columns, rows + 5 * np.sin(columns / 60), cv2.INTER_LINEAR)
    result = calibrate_lens([*board_pictures[:3], bent, *board_pictures[4:]])
    assert [index for index, _ in result.refused] == [3]
    assert "does not fit the other pictures" in result.refused[0][1]
    assert result.lens.residual < 0.15


def test_a_board_always_held_the_same_way_does_not_settle_the_lens() -> None:
    scene = BoardScene(lens())
    middle = np.array([scene.board.columns, scene.board.rows, 0.0]) * scene.board.square / 2
    places = [np.array([0.05 * (i % 3 - 1), 0.04 * (i // 3 - 1), 0.5]) for i in range(9)]
    pictures = [scene.render(np.zeros(3), place - middle, 1, i) for i, place in enumerate(places)]
    with pytest.raises(CalibrationFailed, match="0 pictures show the board tilted"):
        calibrate_lens(pictures)


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.05, -0.04)])
def test_the_place_of_a_camera_follows_from_the_corner_tags(tilt: tuple[float, float]) -> None:
    truth = rehearsal_camera(tilt=tilt, above=1.65)
    seen = OverheadScene(default_table(), truth, OverheadLook(noise=4.0)).render(NOBODY, (), 3, 0)
    found = calibrate_arena(seen, default_table(), lens(), TODAY)
    assert found.arena_residual < 0.5
    assert max(greatest_error(found, truth, height) for height in (0.0, 0.2)) < 0.5


def test_arena_refusals_name_the_tag() -> None:
    seen, table = picture(NOBODY, ()), default_table()
    with pytest.raises(CalibrationFailed, match=r"corner tag 21 not seen.*\(seen: 20, 22, 23\)"):
        calibrate_arena(covered(seen, 21, robots=NOBODY, boxes=()), table, lens(), TODAY)
    with pytest.raises(CalibrationFailed, match="corner tag 22 seen more than once"):
        calibrate_arena(copied(seen, 22, 500, 300, robots=NOBODY, boxes=()), table, lens(), TODAY)
    with pytest.raises(CalibrationFailed, match="640 x 360, the lens was measured at 1280 x 720"):
        calibrate_arena(cv2.resize(seen, (640, 360)), table, lens(), TODAY)
    with pytest.raises(CalibrationFailed, match="no tag at all"):
        calibrate_arena(np.full_like(seen, 90), table, lens(), TODAY)


def test_a_corner_tag_measured_wrong_is_noticed() -> None:
    table = default_table()
    first = table.corners[0]
    wrong = msgspec.structs.replace(table, corners=(CornerTag(id=first.id, x=first.x + 0.03, y=first.y), *table.corners[1:]))
    with pytest.raises(CalibrationFailed, match="mm from where the table says"):
        calibrate_arena(picture(NOBODY, ()), wrong, lens(), TODAY)


def test_a_good_calibration_comes_back(tmp_path: Path) -> None:
    good = msgspec.structs.replace(calibration(), date=TODAY, lens_residual=0.1, arena_residual=0.4)
    save_calibration(good, tmp_path / "overhead.json")
    assert load_calibration(tmp_path / "overhead.json", 1280, 720, TODAY + datetime.timedelta(days=90)) == good


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"date": "2026-01-01"}, "120 days old, 90 are allowed"),
        ({"date": "2026-06-01"}, "yet to come"),
        ({"width": 640, "height": 480}, "for pictures of 640 x 480, the camera gives 1280 x 720"),
        ({"lens_residual": 0.8}, "lens residual of 0.80 px"),
        ({"arena_residual": 9.0}, "arena residual of 9.0 mm"),
        ({"rotation": [1.0] * 9}, "the rotation is none"),
        ({"translation": [0.0, 0.0, -1.0]}, "below the floor"),
        ({"matrix": [0.0] * 9}, "not that of a pinhole"),
        ({"matrix": [1.0] * 3}, "not a calibration: .*matrix"),
        ({"distortion": [1e400] * 5}, "not a calibration|damaged"),
        ({"date": "yesterday"}, "not a calibration: .*date"),
        ({"focus": 3}, "focus"),
    ],
)
def test_calibrations_that_must_not_be_used(tmp_path: Path, change: dict[str, object], says: str) -> None:
    path = tmp_path / "overhead.json"
    save_calibration(msgspec.structs.replace(calibration(), date=TODAY), path)
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | change).replace("Infinity", "1e400"))
    with pytest.raises(UnusableCalibration, match=says) as caught:
        load_calibration(path, 1280, 720, TODAY)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"{", b"null", b"\x00" * 100, b"[" * 100_000, b" " * 1_000_001])
def test_damaged_files_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "overhead.json").write_bytes(content)
    with pytest.raises(UnusableCalibration, match="not a calibration"):
        load_calibration(tmp_path / "overhead.json", 1280, 720, TODAY)
    with pytest.raises(UnusableCalibration, match="No such file"):
        load_calibration(tmp_path / "none.json", 1280, 720, TODAY)


def test_planes_and_pixels_agree_with_a_pinhole_by_hand() -> None:
    """Without distortion: a ray from the centre through a point meets a higher plane where similar triangles say."""
    camera = OverheadCamera(rehearsal_camera(distortion=(0.0, 0.0, 0.0, 0.0, 0.0)))
    floor: npt.NDArray[np.float64] = np.array([[0.1, 0.2, 0.0], [1.1, 0.7, 0.0]])
    for height in (0.1, 0.3):
        share = height / camera.centre[2]
        expected = floor[:, :2] + (camera.centre[:2] - floor[:, :2]) * share
        points, slopes = camera.on_plane(camera.project(floor), height)
        assert points == pytest.approx(expected, abs=1e-9)
        moved, _ = camera.on_plane(camera.project(floor) + np.array([0.01, 0.0]), height)
        assert (moved - points) / 0.01 == pytest.approx(slopes[:, :, 0], rel=1e-3)


def test_lens_is_a_file_of_its_own_kind() -> None:
    with pytest.raises(msgspec.ValidationError, match="matrix"):
        msgspec.json.decode(msgspec.json.encode(lens()).replace(b"[900.0,", b"["), type=Lens)
