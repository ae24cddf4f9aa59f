"""Judging one overhead picture: light, sharpness, tags, and whether the calibration still fits."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from schemas import Box
from vantage.setting_up.annotation import Canvas, tag_names
from vantage.setting_up.verdict import Verdict
from vantage.tracking.calibration import GREATEST_ARENA_RESIDUAL, Calibration
from vantage.tracking.overhead_camera import OverheadCamera
from vantage.tracking.table import TAG_CELLS, Table
from vantage.tracking.tag_pose import measure_pose, mounted_corners
from vantage.tracking.tags import FoundTag, TagFinder, distinct

Picture = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float64]

DARK_MEDIAN: Final = 40
"""Grey level below which the median of a picture is too dark to read tags quickly."""
SATURATED: Final = 250
GREATEST_SATURATED: Final = 0.02
"""Share of the arena's pixels."""
SMALLEST_TAG: Final = 24.0
"""px along the black square: three to each of its cells."""
BLURRED: Final = 0.7
"""Share of a tag's cell that the step from black to white may take at its edge (10 to 90 %)."""
LOW_CONTRAST: Final = 60.0
"""Grey levels between a tag's black and white."""
SCALE_TOLERANCE: Final = 0.025
"""Share by which a tag may look larger or smaller than the table's file says: one of the sizes is wrong, or its height."""
CORNER_SIGMA: Final = 0.1
"""px, standard deviation of a corner found in a picture."""
_REACH: Final = 6.0
_STEP: Final = 0.25


def find_tags(picture: Picture) -> list[FoundTag]:
    """Return every tag in a picture, searched at full resolution: slow, and sure."""
    rows, columns = picture.shape[:2]
    return distinct(_finder().find(picture, (0, 0, columns, rows), half=False))


def check_picture(
    picture: Picture, table: Table, calibration: Calibration | None, *, robots: bool = True
) -> tuple[list[Verdict], Picture]:
    """Judge a picture and annotate it.

    Args:
        picture: uint8 [H, W, 3] RGB, of the calibration's size.
        calibration: None: what needs one is left out.
        robots: whether robots and boxes ought to be there.

    Returns:
        The verdicts, and the annotated picture, uint8 [H, W, 3] RGB.
    """
    camera = None if calibration is None else OverheadCamera(calibration)
    found = find_tags(picture)
    grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    verdicts = [_light(grey, table, camera), *_tags_seen(found, table, robots), *_sharpness(grey, found)]
    canvas = Canvas(picture, camera)
    if calibration is not None and camera is not None:
        canvas.arena(table)
        verdicts.append(_still_in_place(camera, found, table))
        verdicts += _placed(camera, found, table, canvas)
    canvas.tags(found, tag_names(table))
    return verdicts, canvas.picture


def corner_errors(camera: OverheadCamera, found: Sequence[FoundTag], table: Table) -> dict[int, Floats]:
    """Return how far each corner tag's corners are from where the table says, float64 [4] m, by id."""
    places = {tag.id: mounted_corners(table.corner_size, tag.x, tag.y, tag.heading) for tag in table.corners}
    return {
        tag.id: np.linalg.norm(camera.on_plane(tag.corners, 0.0)[0] - places[tag.id], axis=1) for tag in found if tag.id in places
    }


def edge_width(grey: Picture, tag: FoundTag) -> tuple[float, float]:
    """Measure the step from a tag's black square to its white border.

    Across each side, at seven places along it, grey levels are read every quarter pixel.

    Returns:
        px from 10 to 90 % of the step (median over all places), and the step's height in grey levels.
    """
    corners = tag.corners
    middle = tag.centre
    reach = min(_REACH, tag.width / 10.0)
    offsets = np.arange(-reach, reach + _STEP / 2, _STEP)
    widths, heights = [], []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = end - start
        outward = np.array([along[1], -along[0]]) / np.linalg.norm(along)
        outward *= np.sign(outward @ ((start + end) / 2 - middle))
        places = start + along * np.linspace(0.15, 0.85, 7)[:, None]
        lines = places[:, None, :] + offsets[None, :, None] * outward  # [7, n, 2]
        profiles = cv2.remap(
            grey.astype(np.float32), lines[..., 0].astype(np.float32), lines[..., 1].astype(np.float32), cv2.INTER_LINEAR
        )
        profile = np.median(profiles, axis=0)
        low, high = float(profile[:3].mean()), float(profile[-3:].mean())
        heights.append(high - low)
        if high - low > 1.0:
            rising = np.maximum.accumulate((profile - low) / (high - low))
            widths.append(float(np.interp(0.9, rising, offsets) - np.interp(0.1, rising, offsets)))
    return (float(np.median(widths)) if widths else 2 * reach), float(np.median(heights))


@lru_cache(maxsize=1)
def _finder() -> TagFinder:
    return TagFinder()


def _light(grey: Picture, table: Table, camera: OverheadCamera | None) -> Verdict:
    mask = np.full(grey.shape, 255, np.uint8)
    where = "picture"
    if camera is not None:
        ring = np.array([(0, 0, 0), (table.width, 0, 0), (table.width, table.depth, 0), (0, table.depth, 0)], dtype=np.float64)
        mask[:] = 0
        cv2.fillPoly(mask, [np.round(camera.project(ring)).astype(np.int32)], 255)
        where = "arena"
    pixels = grey[mask > 0]
    if pixels.size == 0:
        return Verdict("light", "the arena is not in the picture", "point the camera at the table and calibrate the arena again")
    median, saturated = float(np.median(pixels)), float((pixels >= SATURATED).mean())
    figures = f"median {median:.0f} of 255, {100 * saturated:.1f} % of the {where} saturated"
    if median < DARK_MEDIAN:
        return Verdict("light", figures, f"too dark (below {DARK_MEDIAN}): more light, or a longer exposure")
    if saturated > GREATEST_SATURATED:
        return Verdict("light", figures, f"glare (above {100 * GREATEST_SATURATED:g} %): shade the lamps, or a shorter exposure")
    return Verdict("light", figures)


def _tags_seen(found: Sequence[FoundTag], table: Table, robots: bool) -> list[Verdict]:
    seen = Counter(tag.id for tag in found)
    corners = {tag.id: f"{tag.id}" for tag in table.corners}
    groups = [("corner tags", corners, "lay them flat, whole within the picture, nothing above them, in focus")]
    if robots:
        named = {tag.id: f"{tag.id} ({robot})" for robot, tag in table.robots.items()}
        boxes = {tag.id: f"{tag.id}" for tag in table.obstacles}
        groups.append(("robots' tags", named, "put the robots on the table"))
        groups.append(("boxes' tags", boxes, "put the boxes on the table, or take them out of its file"))
    verdicts = []
    for what, wanted, remedy in groups:
        missing = [name for tag, name in wanted.items() if not seen[tag]]
        figures = f"{len(wanted) - len(missing)} of {len(wanted)} found"
        if missing:
            verdicts.append(Verdict(what, f"{figures}, missing: {', '.join(missing)}", remedy))
        elif wanted:
            verdicts.append(Verdict(what, figures))
    if twice := sorted(tag for tag, count in seen.items() if count > 1):
        listed = ", ".join(map(str, twice))
        verdicts.append(Verdict("tags seen twice", listed, "take the second one away: nobody can tell which is meant"))
    known = tag_names(table)
    if strangers := sorted(set(seen) - set(known)):
        verdicts.append(Verdict("other tags", f"{', '.join(map(str, strangers))} (not in the table's file, passed over)"))
    return verdicts


def _sharpness(grey: Picture, found: Sequence[FoundTag]) -> list[Verdict]:
    if not found:
        return []
    smallest = min(found, key=lambda tag: tag.width)
    size = Verdict(
        "size of tags",
        f"smallest is {smallest.id}: {smallest.width:.0f} px wide",
        "" if smallest.width >= SMALLEST_TAG else f"at least {SMALLEST_TAG:g} px: hang the camera lower, or print larger tags",
    )
    measured = [(*edge_width(grey, tag), tag) for tag in found]
    widest, _, blurred = max(measured, key=lambda row: row[0] / row[2].width)
    _, contrast, pale = min(measured, key=lambda row: row[1])
    limit = BLURRED * blurred.width / TAG_CELLS
    edges = Verdict(
        "sharpness",
        f"edges {widest:.1f} px wide at the least sharp tag, {blurred.id}",
        "" if widest <= limit else f"blurred (above {limit:.1f} px): focus the lens and fix it; is the tag still?",
    )
    levels = Verdict(
        "contrast",
        f"{contrast:.0f} grey levels at the palest tag, {pale.id}",
        "" if contrast >= LOW_CONTRAST else f"pale (below {LOW_CONTRAST:g}): more even light, matt paper, no reflection on it",
    )
    return [size, edges, levels]


def _still_in_place(camera: OverheadCamera, found: Sequence[FoundTag], table: Table) -> Verdict:
    errors = corner_errors(camera, found, table)
    if not errors:
        return Verdict("calibration", "no corner tag to judge it by", "bring the corner tags into the picture")
    root = 1000.0 * float(np.sqrt(np.mean(np.concatenate(list(errors.values())) ** 2)))
    worst = max(errors, key=lambda tag: float(errors[tag].max()))
    figures = f"corner tags are {root:.1f} mm (RMS) from where they were, worst {worst}"
    if root > GREATEST_ARENA_RESIDUAL:
        return Verdict("calibration", figures, "camera or tags have moved: run `vantage table calibrate arena` again")
    return Verdict("calibration", figures)


def _placed(camera: OverheadCamera, found: Sequence[FoundTag], table: Table, canvas: Canvas) -> list[Verdict]:
    """Where robots and boxes are, drawn and judged: inside the arena, and of the size and height that the table's file says."""
    by_id = {tag.id: tag for tag in found}
    verdicts = []
    for robot, mount in table.robots.items():
        if mount.id in by_id:
            corners = mounted_corners(mount.size, mount.forward, mount.left, mount.heading)
            measured = measure_pose(camera, by_id[mount.id].corners, corners, mount.height, CORNER_SIGMA)
            x, y, heading = (float(value) for value in measured.pose)
            canvas.robot(robot, x, y, heading, mount.height)
            verdicts.append(_place(robot, x, y, heading, measured.scale, table))
    for box in table.obstacles:
        if box.id in by_id:
            corners = mounted_corners(box.size, box.along, box.across, box.heading)
            measured = measure_pose(camera, by_id[box.id].corners, corners, box.height, CORNER_SIGMA)
            x, y, heading = (float(value) for value in measured.pose)
            sides = {"half_width": box.half_width, "half_depth": box.half_depth, "height": box.height}
            canvas.box(Box(x=x, y=y, heading=heading, **sides))
            verdicts.append(_place(f"box {box.id}", x, y, heading, measured.scale, table))
    return verdicts


def _place(name: str, x: float, y: float, heading: float, scale: float, table: Table) -> Verdict:
    figures = f"x {1000 * x:.0f} mm, y {1000 * y:.0f} mm, heading {round(math.degrees(heading))}°"
    if not (0.0 <= x <= table.width and 0.0 <= y <= table.depth):
        return Verdict(name, figures, "outside of the arena: put it inside")
    if abs(scale - 1.0) > SCALE_TOLERANCE:
        wrong = f"{figures}; its tag looks {100 * abs(scale - 1.0):.1f} % too {'large' if scale > 1.0 else 'small'}"
        return Verdict(name, wrong, "measure its black square and its height above the floor, and correct the table's file")
    return Verdict(name, figures)
