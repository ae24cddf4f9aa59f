"""Sheets, measured on renderings of the PDFs that people print."""

from __future__ import annotations

from pathlib import Path

import cv2
import msgspec
import numpy as np
import numpy.typing as npt
import pypdfium2
import pytest

from vantage.setting_up.paper import SIZES
from vantage.setting_up.sheets import RULER, write_sheets
from vantage.setting_up.trouble import TableTrouble
from vantage.tracking.lens import BoardDescription, charuco_board
from vantage.tracking.table import ObstacleTag, Table, default_table
from vantage.tracking.tags import FoundTag, TagFinder

Grey = npt.NDArray[np.uint8]
DOTS = 8.0
"""px per mm of the renderings."""


@pytest.fixture(scope="module", params=["a4", "letter"])
def sheets(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    folder = tmp_path_factory.mktemp("prints")
    write_sheets(folder, default_table(), request.param)
    return request.param, folder


def rendered(path: Path) -> list[Grey]:
    with pypdfium2.PdfDocument(path) as document:
        return [cv2.cvtColor(page.render(scale=DOTS * 25.4 / 72.0).to_numpy()[..., :3], cv2.COLOR_BGR2GRAY) for page in document]


def tags_on(path: Path) -> list[tuple[FoundTag, Grey]]:
    finder = TagFinder()
    return [(tag, page) for page in rendered(path) for tag in finder.find(page, (0, 0, page.shape[1], page.shape[0]), half=True)]


def test_pages_have_the_size_of_the_paper(sheets: tuple[str, Path]) -> None:
    paper, folder = sheets
    short, long = SIZES[paper]
    for path in folder.glob("*.pdf"):
        with pypdfium2.PdfDocument(path) as document:
            for page in document:
                size = [points * 25.4 / 72.0 for points in page.get_size()]
                assert size == pytest.approx([long, short] if path.stem == "board" else [short, long], abs=0.01), path


@pytest.mark.parametrize(
    ("sheet", "ids", "size"), [("robots", [0, 1], 60.0), ("obstacles", [10, 11, 12], 60.0), ("corners", [20, 21, 22, 23], 80.0)]
)
def test_tags_are_found_at_true_scale_upright_and_with_their_arrow(
    sheets: tuple[str, Path], sheet: str, ids: list[int], size: float
) -> None:
    found = tags_on(sheets[1] / f"{sheet}.pdf")
    assert sorted(tag.id for tag, _ in found) == ids
    for tag, page in found:
        left_low, right_low, right_top, left_top = tag.corners / DOTS
        for start, end in ((left_low, right_low), (right_low, right_top), (right_top, left_top), (left_top, left_low)):
            assert np.linalg.norm(end - start) == pytest.approx(size, abs=0.2)
        assert right_low[0] - left_low[0] == pytest.approx(size, abs=0.2), "its x axis must point to the right of the page"
        # The white border that the detector needs, and below it the arrow, whose head is dark at the right.
        border = page[
            round((left_top[1] - 0.11 * size) * DOTS) : round((left_low[1] + 0.08 * size) * DOTS),
            round((left_low[0] - 0.08 * size) * DOTS) : round((left_low[0] - 0.01 * size) * DOTS),
        ]
        assert border.min() == 255
        middle, low = (left_low[0] + right_low[0]) / 2, left_low[1] + size / 8
        strip = page[round((low + 0.3) * DOTS) : round((low + 3.8) * DOTS)]
        dark = (strip < 128).sum(axis=0)
        head = dark[round((middle + 0.3 * size) * DOTS) : round((middle + 0.36 * size) * DOTS)].max()
        tail = dark[round((middle - 0.36 * size) * DOTS) : round((middle - 0.3 * size) * DOTS)].max()
        assert head > 3 * tail > 0


def test_tags_measured_by_their_black_square(sheets: tuple[str, Path]) -> None:
    """Without the detector: dark pixels along lines beside the tag's middle, whose outermost cells are black."""
    for tag, page in tags_on(sheets[1] / "robots.pdf"):
        u, v = (round(float(value)) for value in tag.centre)
        half = round(0.6 * 60.0 * DOTS)
        for line in (page[v + 12, u - half : u + half], page[v - half : v + half, u + 12]):
            # Half covered pixels count by how dark they are.
            edge = np.flatnonzero(line < 250)
            inside = line[edge[0] : edge[-1] + 1].astype(float)
            length = (edge[-1] - edge[0] - 1 + (255 - inside[0]) / 255 + (255 - inside[-1]) / 255) / DOTS
            assert length == pytest.approx(60.0, abs=0.2)


def test_the_ruler_is_100_mm_both_ways(sheets: tuple[str, Path]) -> None:
    (page,) = rendered(sheets[1] / "ruler.pdf")
    dark = page < 200
    longest_row = max(int(length) for length in map(_longest_run, dark))
    longest_column = max(int(length) for length in map(_longest_run, dark.T))
    assert longest_row / DOTS == pytest.approx(RULER, abs=0.3)
    assert longest_column / DOTS == pytest.approx(RULER, abs=0.3)


def _longest_run(line: npt.NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], line.astype(np.int8), [0]))))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def test_the_board_is_the_one_that_the_lens_is_measured_with(sheets: tuple[str, Path]) -> None:
    (page,) = rendered(sheets[1] / "board.pdf")
    description = BoardDescription()
    board = charuco_board(description)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(page)
    assert len(ids) == (description.columns - 1) * (description.rows - 1)
    found = corners.reshape(-1, 2)[np.argsort(ids.ravel())] / DOTS
    true = np.asarray(board.getChessboardCorners())[:, :2] * 1000.0
    assert np.abs((found - found[0]) - (true - true[0])).max() < 0.2
    # Square by square as OpenCV draws it, but for a pixel at the edges.
    upper_left = np.round((found[0] - true[0]) * DOTS).astype(int)
    square = 1000 * description.square * DOTS
    size = (round(description.columns * square), round(description.rows * square))
    drawn = board.generateImage(size, marginSize=0, borderBits=1)
    printed = page[upper_left[1] : upper_left[1] + size[1], upper_left[0] : upper_left[0] + size[0]]
    different = ((drawn < 128) != (printed < 128)).astype(np.uint8)
    assert not cv2.erode(different, np.ones((5, 5), np.uint8)).any()


def test_sizes_follow_the_tables_file(tmp_path: Path) -> None:
    table = default_table()
    changed = msgspec.structs.replace(
        table, obstacles=(ObstacleTag(id=77, half_width=0.1, half_depth=0.1, size=0.045, heading=0.5),)
    )
    write_sheets(tmp_path, changed, "a4")
    ((tag, _),) = tags_on(tmp_path / "obstacles.pdf")
    assert tag.id == 77
    assert tag.width / DOTS == pytest.approx(45.0, abs=0.2)


def test_a_table_without_boxes_has_no_sheet_of_boxes(tmp_path: Path) -> None:
    write_sheets(tmp_path, msgspec.structs.replace(default_table(), obstacles=()), "a4")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["board.pdf", "corners.pdf", "robots.pdf", "ruler.pdf"]


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TableTrouble, match="tag 20 of 200 mm does not fit on a4"):
        write_sheets(tmp_path, msgspec.structs.replace(default_table(), corner_size=0.2), "a4")


def test_printing_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    table: Table = default_table()
    for name in ("one", "two"):
        write_sheets(tmp_path / name, table, "a4")
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()
