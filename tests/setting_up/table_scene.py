"""One rendered table for all tests of setting up."""

from __future__ import annotations

import datetime
from functools import lru_cache
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt

from schemas import Box
from vantage.rehearsal.board_picture import BoardScene, draw_views
from vantage.rehearsal.overhead_light import OverheadLook
from vantage.rehearsal.overhead_picture import OverheadScene, rehearsal_camera
from vantage.setting_up.pictures import write_picture
from vantage.tracking.calibration import Calibration, save_calibration
from vantage.tracking.lens import Lens
from vantage.tracking.table import CornerTag, default_table, save_table
from vantage.world.layout import LAB

Picture = npt.NDArray[np.uint8]
ROBOTS = np.array([[0.30, 0.30, 0.5], [0.80, 0.45, 2.5]])
NOBODY = np.full((2, 3), np.nan)
BOARDS = 16


def true_lens() -> Lens:
    truth = rehearsal_camera()
    return Lens(width=truth.width, height=truth.height, matrix=truth.matrix, distortion=truth.distortion, residual=0.1)


def calibration_of_today() -> Calibration:
    return msgspec.structs.replace(rehearsal_camera(date=datetime.date.today()), lens_residual=0.1, arena_residual=0.2)


@lru_cache(maxsize=1)
def board_pictures() -> tuple[Picture, ...]:
    scene = BoardScene(true_lens())
    return tuple(scene.render(*view, 1, number) for number, view in enumerate(draw_views(BOARDS, scene.board, 1)))


@lru_cache(maxsize=16)
def picture(
    robots: bool = True,
    look: OverheadLook | None = None,
    covered: frozenset[int] = frozenset(),
    strays: tuple[CornerTag, ...] = (),
    boxes: tuple[Box, ...] = LAB,
) -> Picture:
    """The table from above."""
    scene = OverheadScene(default_table(), rehearsal_camera(), look or OverheadLook(), strays, covered)
    return scene.render(ROBOTS if robots else NOBODY, boxes if robots else (), 1, 0)


def write_lab(folder: Path) -> None:
    """Write what a lab has once it is calibrated, and a picture of its table."""
    save_table(default_table(), folder / "table.json")
    save_calibration(calibration_of_today(), folder / "overhead.json")
    write_picture(folder / "game.png", picture())
