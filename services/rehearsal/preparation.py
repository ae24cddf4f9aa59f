"""Before a rehearsal: the table is laid out, and its cameras are calibrated as a real table's are, from pictures alone.

What the tracker is given is what the calibration found. How the cameras truly are stays here.
"""

from __future__ import annotations

import datetime
import math
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np

from schemas import ROBOTS, Box
from vantage.rehearsal.board_picture import BoardScene, draw_views
from vantage.rehearsal.overhead_light import OverheadLook
from vantage.rehearsal.overhead_picture import OverheadScene, rehearsal_camera
from vantage.rehearsal.rgbd_picture import RgbdCamera, RgbdLook, render_rgbd
from vantage.tracking.calibration import Calibration, Lens, calibrate_arena, calibrate_lens, save_calibration
from vantage.tracking.colors import correct_colors, measure_rectangle
from vantage.tracking.rgbd import RgbdCalibration, default_rgbd, save_rgbd
from vantage.tracking.table import ObstacleTag, Table, default_table, save_table
from vantage.world.arena import HIDER, SEEKER
from vantage.world.layout import boxes_array, check_layout, make_layout
from vantage.world.start import draw_start

BOARD_PICTURES = 16
MADE_WITH = "rehearsal"
_FIRST_OBSTACLE_TAG = 10
_PATCH_DISTANCE = 0.25
"""m from a camera to what its colours are measured on."""
_FLOOR_SHARE = 12
"""This part of a picture, at its lower edge, shows the floor."""


@dataclass(frozen=True)
class TableSettings:
    """What stands on the table, for as long as the rehearsal runs."""

    layout: str = "lab"
    """`lab`, `random`, or the path of a layout file: as in a game, but fixed, for boxes do not move by themselves."""
    layout_seed: int = 1
    """of the layout `random`, and of where the robots stand at first"""


@dataclass(frozen=True)
class Prepared:
    """A table and its cameras as they truly are."""

    table: Table
    obstacles: tuple[Box, ...]
    starts: tuple[tuple[float, float, float], tuple[float, float, float]]
    scene: OverheadScene
    cameras: dict[str, RgbdCamera] = field(default_factory=dict)


def prepare_table(
    settings: TableSettings, overhead_size: tuple[int, int] = (1280, 720), rgbd: RgbdCalibration | None = None
) -> Prepared:
    """Lay the table out and put its cameras up.

    Args:
        overhead_size: width and height of the overhead camera's pictures, px.
        rgbd: the robots' cameras but for what sets two of one type apart; default `default_rgbd`.

    Raises:
        ImpossibleLayout: nobody could play on it.
        UnusableTable: a box is too small for its tag.
    """
    obstacles = make_layout(settings.layout, settings.layout_seed)
    bare = default_table()
    check_layout(obstacles, bare.width, bare.depth)
    tags = tuple(
        ObstacleTag(id=_FIRST_OBSTACLE_TAG + number, half_width=box.half_width, half_depth=box.half_depth, height=box.height)
        for number, box in enumerate(obstacles)
    )
    table = msgspec.structs.replace(bare, obstacles=tags)
    hider, seeker = draw_start(boxes_array(obstacles), table.width, table.depth, settings.layout_seed, 0.25, 0.45)
    starts = tuple((x, y, math.radians(10.0 * heading)) for x, y, heading in (hider, seeker))
    scene = OverheadScene(table, rehearsal_camera(*overhead_size, arena=(table.width, table.depth)), OverheadLook())
    one = rgbd or default_rgbd()
    # Two cameras of one type differ a little in how they sit and in their colours.
    cameras = {
        "hider": _camera(one, tilt=math.radians(5.2), height=0.0804, look=RgbdLook(red_gain=0.96, blue_gain=1.05)),
        "seeker": _camera(one, tilt=math.radians(4.8), height=0.0797, look=RgbdLook(green_gain=0.97, brightness=0.95)),
    }
    return Prepared(table, obstacles, (starts[HIDER], starts[SEEKER]), scene, cameras)


def _camera(one: RgbdCalibration, tilt: float, height: float, look: RgbdLook) -> RgbdCamera:
    return RgbdCamera(msgspec.structs.replace(one, tilt=tilt, mount_height=height), look)


def calibrate_and_write(prepared: Prepared, folder: Path, seed: int) -> None:
    """Calibrate all cameras from pictures of boards, corner tags and robots, and write what the tracker reads into `folder`.

    Raises:
        CalibrationFailed, UnusableColors: the pictures do not make a calibration.
    """
    overhead = calibrate_overhead(prepared, seed)
    robots = {robot: calibrate_rgbd(prepared.cameras[robot], seed, index) for index, robot in enumerate(ROBOTS)}
    for robot, calibration in robots.items():
        save_rgbd(calibration, folder / f"{robot}.json")
    save_calibration(overhead, folder / "overhead.json")
    save_table(prepared.table, folder / "table.json")


def calibrate_overhead(prepared: Prepared, seed: int) -> Calibration:
    """Return what is found from pictures of a board held under the camera, and one of the corner tags on the bare table.

    Raises:
        CalibrationFailed: the pictures do not make a calibration.
    """
    camera, table = prepared.scene.camera, prepared.table
    truth = rehearsal_camera(camera.width, camera.height, arena=(table.width, table.depth))
    lens = Lens(width=truth.width, height=truth.height, matrix=truth.matrix, distortion=truth.distortion, residual=0.0)
    board = BoardScene(lens)
    views = draw_views(BOARD_PICTURES, board.board, seed)
    pictures = [board.render(*view, seed, number) for number, view in enumerate(views)]
    nobody = np.full((2, 3), np.nan)
    bare = prepared.scene.render(nobody, (), seed, 0)
    return calibrate_arena(bare, prepared.table, calibrate_lens(pictures).lens, datetime.date.today(), MADE_WITH)


def calibrate_rgbd(camera: RgbdCamera, seed: int, index: int) -> RgbdCalibration:
    """Return what somebody finds who sets a robot's camera up: lenses as its maker measured them, height to a millimetre and tilt
    to half a degree with ruler and spirit level, colours measured on both robots and the floor.
    """
    pose = (0.2, 0.6, 0.0)
    pictures = [
        render_rgbd(camera, boxes_array(()), pose, (pose[0] + _PATCH_DISTANCE, pose[1]), color, seed, number, index)[1]
        for number, color in enumerate((HIDER, SEEKER))
    ]
    lens = camera.geometry.color
    # The robot's middle, level with the camera and straight ahead of it.
    column = round(lens.cx + lens.fx * camera.geometry.translation[0] / _PATCH_DISTANCE)
    row = round(lens.cy - lens.fy * math.tan(camera.geometry.tilt))
    across, down = lens.width // 20, lens.height // 24
    hider, seeker = (measure_rectangle(picture, column - across // 2, row - down // 2, across, down) for picture in pictures)
    floor = lens.height // _FLOOR_SHARE
    grey = measure_rectangle(pictures[0], 2 * lens.width // 5, lens.height - floor, lens.width // 5, 7 * floor // 8)
    correction, _ = correct_colors(hider, seeker, grey)
    return msgspec.structs.replace(
        camera.geometry,
        mount_height=round(camera.geometry.mount_height, 3),
        tilt=math.radians(round(2.0 * math.degrees(camera.geometry.tilt)) / 2.0),
        correction=correction,
        date=datetime.date.today().isoformat(),
        made_with=MADE_WITH,
    )
