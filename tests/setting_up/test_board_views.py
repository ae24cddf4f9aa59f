"""Views of the board: which are kept, which are asked for."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import count

import cv2
import numpy as np
import pytest

from tests.setting_up.table_scene import board_pictures, true_lens
from vantage.rehearsal.board_picture import BoardScene
from vantage.setting_up.board_views import TILTED, TILTED_VIEWS, WANTED_VIEWS, BoardViews, coverage_picture
from vantage.setting_up.calibrating import gather_views
from vantage.setting_up.pictures import Source, View


def held(across: float, up: float, aim: tuple[float, float] = (0.0, 0.0), away: float = 0.45) -> np.ndarray:
    """A picture of the board turned about the picture's upright axis by `across` and about its level one by `up`, degrees."""
    scene = BoardScene(true_lens())
    turn = cv2.Rodrigues(np.array([0.0, math.radians(across), 0.0]))[0] @ cv2.Rodrigues(np.array([math.radians(up), 0.0, 0.0]))[0]
    middle = np.array([scene.board.columns, scene.board.rows, 0.0]) * scene.board.square / 2
    place = np.array([aim[0], aim[1], 1.0]) * away - turn @ middle
    return scene.render(cv2.Rodrigues(turn)[0].ravel(), place, 1, 0)


def test_nothing_seen_everything_missing() -> None:
    views = BoardViews()
    assert "only 0 corners" in views.offer("grey", np.full((720, 1280, 3), 120, np.uint8))
    missing = views.missing()
    assert len(missing) == 9 + 4 + 1
    assert f"{WANTED_VIEWS} more views" in missing


@pytest.mark.parametrize(
    ("across", "up", "wish"),
    [
        (25.0, 0.0, "its right side nearer"),
        (-25.0, 0.0, "its left side nearer"),
        (0.0, -25.0, "its lower side nearer"),
        (0.0, 25.0, "its upper side nearer"),
    ],
)
def test_tilts_are_told_apart(across: float, up: float, wish: str) -> None:
    """Brute force: which side is nearer follows from where the board's edges are, computed from the same rotation."""
    turn = cv2.Rodrigues(np.array([0.0, math.radians(across), 0.0]))[0] @ cv2.Rodrigues(np.array([math.radians(up), 0.0, 0.0]))[0]
    depths = {
        "its left side nearer": (turn @ [-1.0, 0.0, 0.0])[2],
        "its right side nearer": (turn @ [1.0, 0.0, 0.0])[2],
        "its upper side nearer": (turn @ [0.0, -1.0, 0.0])[2],
        "its lower side nearer": (turn @ [0.0, 1.0, 0.0])[2],
    }
    assert min(depths, key=lambda side: depths[side]) == wish
    views = BoardViews()
    for number, aim in enumerate(((-0.25, -0.1), (0.25, 0.1))[:TILTED_VIEWS]):
        assert views.offer(str(number), held(across, up, aim)) == ""
        tilt = views.views[-1].tilt
        assert max(abs(tilt[0]), abs(tilt[1])) > TILTED
    open_wishes = views.missing()
    assert f"the board tilted, {wish}" not in open_wishes
    assert sum("tilted" in text for text in open_wishes) == 3


def test_the_same_view_is_not_taken_twice_and_another_size_is_refused() -> None:
    views = BoardViews()
    picture = board_pictures()[0]
    assert views.offer("first", picture) == ""
    assert views.offer("again", picture) == "it shows what a picture before it shows"
    assert "640 x 360 pixels, those before 1280 x 720" in views.offer("small", np.ascontiguousarray(picture[::2, ::2]))
    assert len(views.views) == 1


def test_a_camera_is_looked_at_until_its_time_is_over() -> None:
    board = board_pictures()

    def camera() -> Iterator[View]:
        for number in count():
            yield View(f"picture {number}", board[number % len(board)], 0.5 * number)

    looked: list[int] = []
    source = Source("camera 0", live=True, count=None, views=camera())
    views, refused = gather_views(source, 3.0, lambda _, number: looked.append(number))
    assert looked == [1, 2, 3, 4, 5, 6, 7, 8]
    assert refused == [], "of a camera not every picture that shows nothing new is named"
    assert 0 < len(views.views) <= 8


def test_a_camera_is_left_when_nothing_is_missing() -> None:
    board = board_pictures()
    endless = (View(f"picture {number}", board[number % 3], 0.01 * number) for number in count())
    seen: list[int] = []

    class Content(BoardViews):
        def missing(self) -> list[str]:
            return [] if len(self.views) == 2 else super().missing()

    views, _ = gather_views(Source("camera 0", True, None, endless), 60.0, lambda _, number: seen.append(number), Content())
    assert len(views.views) == 2
    assert len(seen) < 5


def test_places_are_ticked_off_where_the_board_was() -> None:
    views = BoardViews()
    views.offer("low right", held(0.0, 0.0, (0.35, 0.2), 0.6))
    wishes = views.missing()
    assert "the board in the lower right corner of the picture" not in wishes
    assert "the board in the upper left corner of the picture" in wishes
    shown = coverage_picture(views)
    rows, columns = np.nonzero(shown.max(axis=2) > 150)
    assert shown.shape == (720, 1280, 3)
    assert columns.mean() > 640 and rows.mean() > 360
