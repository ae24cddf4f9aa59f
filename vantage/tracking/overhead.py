"""Follows the tags on robots and boxes through the overhead camera's pictures.

Between searches of the whole picture, each robot's tag is sought in a window around its predicted place and one standing tag a
frame in a window around its own: the cost follows the number of robots, not of pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np
import numpy.typing as npt

from schemas import Box
from vantage.tracking.calibration import Calibration
from vantage.tracking.filter import FilterSettings, PoseFilter, TrackState
from vantage.tracking.overhead_camera import OverheadCamera
from vantage.tracking.picture_quality import WEAK_MARGIN, light_trouble, why_unseen
from vantage.tracking.standing_tags import StandingTag
from vantage.tracking.table import Table
from vantage.tracking.tag_pose import MeasuredPose, measure_pose, mounted_corners
from vantage.tracking.tag_search import SearchPlan, clipped, tiles_of
from vantage.tracking.tags import SMALLEST_FOR_HALF, FoundTag, TagFinder, Window, distinct, grey_of

Floats = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

_BORDERED = 1.25 * math.sqrt(2.0)
"""Diagonal of a tag with its white border over the side of its black square."""


@dataclass(frozen=True)
class OverheadSettings:
    """How tags are followed."""

    corner_sigma: float = 0.15
    """standard deviation of a tag's corner in the picture, px; with reserve for motion blur and lens"""
    window_margin: float = 8.0
    """px around a tag's predicted place beyond three standard deviations of it"""
    largest_window: float = 110.0
    """half a window's side at most, px"""
    search_period: float = 2.0
    """s between two searches of the whole picture, tile by tile"""
    urgent_search_period: float = 0.3
    """s between two searches of the whole picture while a robot is missing"""
    missed_frames: int = 3
    """frames without a robot's tag after which it is missing"""
    scale_tolerance: float = 0.07
    """share by which a tag may seem larger or smaller than it is"""
    residual_limit: float = 0.004
    """m that a tag's corners may stray from a square, root mean square"""
    tell_after: float = 0.3
    """s a robot is unseen until that is a trouble"""
    tell_standing_after: float = 5.0
    """s a standing tag is unseen until that is a trouble"""
    keep_box: float = 10.0
    """s a box stays in the layout without its tag"""
    corner_moved: float = 0.006
    """m a corner tag may seem to lie beside its place"""
    light_period: float = 0.5
    """s between two looks at the light"""
    filter: FilterSettings = field(default_factory=FilterSettings)


@dataclass(frozen=True, slots=True)
class Observation:
    """What one picture says.

    Attributes:
        tracks: by robot; None where nothing is known.
        boxes: obstacles found so far, held steady; in the order of the table.
        troubles: for people, one line each.
        full_search: whether a search of the whole picture was completed with this one.
    """

    tracks: dict[str, TrackState | None]
    boxes: tuple[Box, ...]
    troubles: tuple[str, ...]
    full_search: bool


class _Mount:
    """A tag on what carries it, as the camera sees it."""

    def __init__(self, name: str, tag: int, size: float, height: float, mounted: Floats, camera: OverheadCamera) -> None:
        self.name, self.tag, self.height, self.mounted = name, tag, height, mounted
        self.width = size * camera.scale_at(height)  # px of the black square
        self.half = self.width >= SMALLEST_FOR_HALF
        self._camera = camera
        self._middle = mounted.mean(axis=0)

    def place(self, pose: Floats) -> Floats:
        """Where the tag's centre appears when its carrier stands at pose float64 [3]: float64 [2] px."""
        cosine, sine = math.cos(pose[2]), math.sin(pose[2])
        x = pose[0] + cosine * self._middle[0] - sine * self._middle[1]
        y = pose[1] + sine * self._middle[0] + cosine * self._middle[1]
        return np.asarray(self._camera.project(np.array([[x, y, self.height]]))[0])


class OverheadTracker:
    """Follows the tags from picture to picture. Not thread-safe.

    Args:
        table: which tag is where.
        calibration: of the camera; pictures must have its resolution.
        settings: how tags are followed.
    """

    def __init__(self, table: Table, calibration: Calibration, settings: OverheadSettings | None = None) -> None:
        self.table, self.calibration, self.settings = table, calibration, settings or OverheadSettings()
        self.camera = OverheadCamera(calibration)
        self._finder = TagFinder()
        self._robots: dict[str, _Mount] = {}
        self._filters: dict[str, PoseFilter] = {}
        for robot, mount in table.robots.items():
            corners = mounted_corners(mount.size, mount.forward, mount.left, mount.heading)
            self._robots[robot] = _Mount(f"{robot}'s tag {mount.id}", mount.id, mount.size, mount.height, corners, self.camera)
            self._filters[robot] = PoseFilter(self.settings.filter)
        self._standing: list[tuple[_Mount, StandingTag]] = []
        for obstacle in table.obstacles:
            corners = mounted_corners(obstacle.size, obstacle.along, obstacle.across, obstacle.heading)
            name = f"box tag {obstacle.id}"
            mount_ = _Mount(name, obstacle.id, obstacle.size, obstacle.height, corners, self.camera)
            self._standing.append((mount_, StandingTag()))
        flat = mounted_corners(table.corner_size, 0.0, 0.0, 0.0)
        for corner in table.corners:
            name = f"corner tag {corner.id}"
            self._standing.append((_Mount(name, corner.id, table.corner_size, 0.0, flat, self.camera), StandingTag()))
        widths = [mount.width for mount in (*self._robots.values(), *(mount for mount, _ in self._standing))]
        self._half_search = min(widths) >= SMALLEST_FOR_HALF
        tiles = tiles_of(calibration.width, calibration.height, math.ceil(max(widths) * _BORDERED * 1.2))
        self._plan = SearchPlan(tiles, self.settings.search_period, self.settings.urgent_search_period)
        self._missed = dict.fromkeys(table.robots, 0)
        self._last_seen: dict[str, int] = {}
        self._last_place: dict[str, Floats] = {}
        self._reasons: dict[str, str] = {}
        self._twins: dict[str, tuple[int, str]] = {}
        self._unlike: dict[str, tuple[int, str]] = {}
        self._margin = 100.0
        self._light = ""
        self._light_stamp: int | None = None
        self._turn = 0
        self._begun: int | None = None
        self._stamp = 0

    def observe(self, picture: Picture, stamp: int) -> Observation:
        """Take the next picture: uint8 [H, W] or [H, W, 3] RGB, captured at stamp (ns). Never raises for what is in a picture."""
        if self._begun is None or stamp < self._stamp:
            self._start_clock(stamp)
        self._stamp = stamp
        for filter_ in self._filters.values():
            filter_.predict(stamp)
        size = (self.calibration.width, self.calibration.height)
        if picture.ndim not in (2, 3) or (picture.shape[1], picture.shape[0]) != size:
            shape = f"{picture.shape[1]} x {picture.shape[0]}" if picture.ndim in (2, 3) else f"of {picture.ndim} dimensions"
            trouble = f"overhead picture is {shape}, the calibration is for {size[0]} x {size[1]}: set the camera, or calibrate"
            return Observation(self._tracks(), self._boxes(), (trouble,), False)
        for robot in self._robots:
            self._follow(robot, picture)
        self._visit_standing(picture)
        searched = self._search(picture)
        if self._light_stamp is None or stamp - self._light_stamp >= self.settings.light_period * 1e9:
            self._light_stamp, self._light = stamp, light_trouble(picture)
        return Observation(self._tracks(), self._boxes(), self._troubles(picture), searched)

    def _start_clock(self, stamp: int) -> None:
        """Forget every stamp: the first picture, or one of a clock that went backwards."""
        self._begun, self._light_stamp = stamp, None
        self._last_seen.clear()
        self._twins.clear()
        self._unlike.clear()
        for _, standing in self._standing:
            if standing.last_seen is not None:
                standing.last_seen = stamp

    def _find(self, picture: Picture, mount: _Mount, place: Floats, half: float) -> list[FoundTag]:
        window = clipped(place[0], place[1], half, self.calibration.width, self.calibration.height)
        found = [tag for tag in self._finder.find(picture, window, mount.half) if tag.id == mount.tag]
        if not found and mount.half:
            found = [tag for tag in self._finder.find(picture, window, False) if tag.id == mount.tag]
        return found

    def _follow(self, robot: str, picture: Picture) -> None:
        """Look for a robot's tag around its predicted place."""
        mount, filter_ = self._robots[robot], self._filters[robot]
        if not filter_.alive:
            self._missed[robot] += 1
            return
        place = mount.place(filter_.pose)
        reach = 3 * filter_.spread * self.camera.scale_at(mount.height) + self.settings.window_margin
        half = min(mount.width * _BORDERED / 2 + reach, self.settings.largest_window)
        found = self._nearest(mount, self._find(picture, mount, place, half), place)
        self._missed[robot] += 1
        if found is not None:
            self._correct(robot, found)

    def _correct(self, robot: str, found: FoundTag) -> None:
        measured = self._measure(self._robots[robot], found)
        if measured is not None and self._filters[robot].correct(measured.pose, measured.covariance, self._stamp):
            self._missed[robot] = 0
            self._last_seen[robot], self._last_place[robot] = self._stamp, found.centre
            self._reasons.pop(robot, None)
            self._margin += 0.1 * (found.margin - self._margin)

    def _nearest(self, mount: _Mount, found: list[FoundTag], place: Floats) -> FoundTag | None:
        """The one of some tags of one id that is nearest to where it is expected; the others are a trouble."""
        found = sorted(distinct(found), key=lambda tag: float(np.linalg.norm(tag.centre - place)))
        if len(found) > 1:
            self._note_twins(mount, found)
        return found[0] if found else None

    def _note_twins(self, mount: _Mount, found: list[FoundTag]) -> None:
        points = [self.camera.on_plane(tag.centre[None], mount.height)[0][0] for tag in found]
        places = " and ".join(f"({x:.2f}, {y:.2f})" for x, y in sorted(tuple(point.tolist()) for point in points))
        self._twins[mount.name] = (self._stamp, f"{mount.name} is seen twice, at {places} m: take one away")

    def _measure(self, mount: _Mount, found: FoundTag) -> MeasuredPose | None:
        """The pose that a tag gives, unless it is not as large, as high or as flat as the table says."""
        measured = measure_pose(self.camera, found.corners, mount.mounted, mount.height, self.settings.corner_sigma)
        off = measured.scale - 1.0
        if abs(off) > self.settings.scale_tolerance:
            word = "large" if off > 0 else "small"
            text = f"{mount.name} looks {100 * abs(off):.0f} % too {word}: lifted, or its size or height in the table is wrong"
        elif measured.residual > self.settings.residual_limit or not np.isfinite(measured.pose).all():
            text = f"{mount.name} is not flat: {1000 * measured.residual:.0f} mm off a square"
        else:
            return measured
        self._unlike[mount.name] = (self._stamp, text)
        return None

    def _visit_standing(self, picture: Picture) -> None:
        """Look at one standing tag in its turn, and at all that have not settled."""
        count = len(self._standing)
        self._turn = (self._turn + 1) % count
        for index, (mount, standing) in enumerate(self._standing):
            if standing.latest is None or not (index == self._turn or not standing.settled):
                continue
            if index != self._turn and standing.last_seen != self._stamp and self._unseen_for(standing) > 0.5:
                continue
            place = mount.place(standing.latest)
            half = mount.width * _BORDERED / 2 + 2 * self.settings.window_margin
            found = self._nearest(mount, self._find(picture, mount, place, half), place)
            if found is not None:
                self._see_standing(mount, standing, found)
        for index, _ in enumerate(self.table.obstacles):
            standing = self._standing[index][1]
            if standing.latest is not None and self._unseen_for(standing) > self.settings.keep_box:
                standing.forget()

    def _unseen_for(self, standing: StandingTag) -> float:
        since = standing.last_seen if standing.last_seen is not None else self._begun
        return (self._stamp - (since or 0)) * 1e-9

    def _see_standing(self, mount: _Mount, standing: StandingTag, found: FoundTag) -> None:
        measured = self._measure(mount, found)
        if measured is not None:
            standing.see(measured.pose, self._stamp)

    def _search(self, picture: Picture) -> bool:
        """Search beyond the windows when it is time; returns whether that completed the picture."""
        urgent = any(
            not self._filters[robot].alive or missed >= self.settings.missed_frames for robot, missed in self._missed.items()
        )
        whole = self._plan.whole_due(self._stamp, urgent)
        window: Window | None = (0, 0, self.calibration.width, self.calibration.height)
        completes = whole
        if not whole:
            window, completes = self._plan.tile_due(self._stamp)
        if window is None:
            return False
        found = distinct(self._finder.find(picture, window, self._half_search))
        by_id: dict[int, list[FoundTag]] = {}
        for tag in found:
            by_id.setdefault(tag.id, []).append(tag)
        for robot, mount in self._robots.items():
            self._take_robot(robot, by_id.get(mount.tag, []), whole)
        for mount, standing in self._standing:
            self._take_standing(mount, standing, by_id.get(mount.tag, []))
        return completes

    def _take_robot(self, robot: str, found: list[FoundTag], whole: bool) -> None:
        """Use what a search found of a robot's tag: a second one is a trouble, a missing one is found again."""
        mount, filter_ = self._robots[robot], self._filters[robot]
        if not found:
            return
        if self._missed[robot] == 0:
            place = self._last_place[robot]
            others = [tag for tag in found if np.linalg.norm(tag.centre - place) > mount.width / 2]
            if others:
                here = FoundTag(mount.tag, place + np.zeros((4, 2)), 0.0)
                self._note_twins(mount, [here, *others])
        elif filter_.alive:
            nearest = self._nearest(mount, found, mount.place(filter_.pose))
            if nearest is not None:
                self._correct(robot, nearest)
        elif len(found) > 1:
            self._note_twins(mount, found)
        elif whole:
            self._correct(robot, found[0])

    def _take_standing(self, mount: _Mount, standing: StandingTag, found: list[FoundTag]) -> None:
        if not found:
            return
        if standing.latest is None:
            if len(found) > 1:
                self._note_twins(mount, found)
            else:
                self._see_standing(mount, standing, found[0])
            return
        place = mount.place(standing.latest)
        others = [tag for tag in found if np.linalg.norm(tag.centre - place) > mount.width / 2]
        if others and self._unseen_for(standing) < 1.0:
            self._note_twins(mount, [FoundTag(mount.tag, place + np.zeros((4, 2)), 0.0), *others])
        elif len(others) == 1 and len(found) == 1:
            self._see_standing(mount, standing, found[0])

    def _tracks(self) -> dict[str, TrackState | None]:
        return {robot: filter_.state for robot, filter_ in self._filters.items()}

    def _boxes(self) -> tuple[Box, ...]:
        boxes = []
        for obstacle, (_, standing) in zip(self.table.obstacles, self._standing, strict=False):
            if standing.held is not None:
                x, y, heading = (float(value) for value in standing.held)
                sides = {"half_width": obstacle.half_width, "half_depth": obstacle.half_depth, "height": obstacle.height}
                boxes.append(Box(x=x, y=y, heading=heading, **sides))
        return tuple(boxes)

    def _troubles(self, picture: Picture) -> tuple[str, ...]:
        troubles = [self._light] if self._light else []
        for robot, mount in self._robots.items():
            since = self._last_seen.get(robot)
            if self._missed[robot] == 0 or self._stamp - (since or self._begun or 0) <= self.settings.tell_after * 1e9:
                continue
            if since is None:
                troubles.append(f"{mount.name} was never seen: is it in the picture, flat, and in the table's file?")
                continue
            if robot not in self._reasons:
                column, row = self._last_place[robot]
                window = clipped(column, row, 0.75 * mount.width, self.calibration.width, self.calibration.height)
                self._reasons[robot] = why_unseen(grey_of(picture, window))
            reason = f" ({self._reasons[robot]})" if self._reasons[robot] else ""
            troubles.append(f"{mount.name} not seen since {_clock(since)}{reason}")
        known = {f"corner tag {corner.id}": corner for corner in self.table.corners}
        for mount, standing in self._standing:
            if self._unseen_for(standing) > self.settings.tell_standing_after:
                since = standing.last_seen
                troubles.append(f"{mount.name} " + (f"not seen since {_clock(since)}" if since else "was never seen"))
            elif mount.name in known and standing.held is not None:
                corner = known[mount.name]
                off = math.hypot(standing.held[0] - corner.x, standing.held[1] - corner.y)
                if off > self.settings.corner_moved:
                    troubles.append(f"{mount.name} lies {1000 * off:.0f} mm from its place: camera or tag moved, calibrate again")
        lasting = round(1.5 * self.settings.search_period * 1e9)
        troubles += [text for stamp, text in self._twins.values() if self._stamp - stamp <= lasting]
        troubles += [text for stamp, text in self._unlike.values() if self._stamp - stamp <= lasting]
        if self._margin < WEAK_MARGIN and not self._light:
            troubles.append(f"tags are hardly readable (margin {self._margin:.0f}): focus the lens, more light, less noise")
        return tuple(troubles)


def _clock(stamp: int) -> str:
    return datetime.fromtimestamp(stamp / 1e9).strftime("%H:%M:%S")
