"""Follows the tags on robots and boxes through the overhead camera's pictures.

Between searches of the whole picture, each robot's tag is sought in a window around its predicted place and one standing tag a
frame in a window around its own: the cost follows the number of robots, not of pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from schemas import Box
from vantage.tracking.calibration import Calibration
from vantage.tracking.filter import FilterSettings, PoseFilter, TrackState
from vantage.tracking.overhead_camera import OverheadCamera
from vantage.tracking.picture_quality import WEAK_MARGIN, light_trouble, why_unseen
from vantage.tracking.standing_tags import StandingTag, box_at
from vantage.tracking.table import Table
from vantage.tracking.tag_mount import NotAsMounted, TagMount, box_mounts, corner_mounts, robot_mounts
from vantage.tracking.tag_pose import MeasuredPose
from vantage.tracking.tag_search import SearchPlan, clipped, tiles_of
from vantage.tracking.tags import FoundTag, TagFinder, Window, distinct, grey_of
from vantage.tracking.trouble_book import TroubleBook, clock, elsewhere, twins_text

GAP = 1_000_000_000
"""ns without a picture after which nothing counts as unseen for as long."""

Floats = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]


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
        box_tags: the tags on them, in the same order.
        boxes_known: whether these are all: searched in pictures with light, and none was seen too seldom to have its place yet.
            Boxes of the table that the first search did not find are given a second one.
        troubles: for people, one line each.
        full_search: whether a search of the whole picture was completed with this one.
    """

    tracks: dict[str, TrackState | None]
    boxes: tuple[Box, ...]
    box_tags: tuple[int, ...]
    boxes_known: bool
    troubles: tuple[str, ...]
    full_search: bool


class _Robot:
    """One robot's tag and track."""

    def __init__(self, mount: TagMount, settings: FilterSettings) -> None:
        self.mount, self.filter = mount, PoseFilter(settings)
        self.missed = 0  # frames in a row without its tag
        self.last_seen: int | None = None
        self.last_place: Floats = np.zeros(2)
        self.reason: str | None = None  # why it is not seen, once that was looked into


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
        mounts = robot_mounts(table, self.camera)
        self._robots = {robot: _Robot(mount, self.settings.filter) for robot, mount in mounts.items()}
        self._boxes = [(mount, StandingTag()) for mount in box_mounts(table, self.camera)]
        self._corners = [(mount, StandingTag()) for mount in corner_mounts(table, self.camera)]
        self._standing = self._boxes + self._corners
        everything = [*mounts.values(), *(mount for mount, _ in self._standing)]
        self._half_search = all(mount.half for mount in everything)
        overlap = math.ceil(1.2 * max(mount.diagonal for mount in everything))
        tiles = tiles_of(calibration.width, calibration.height, overlap)
        self._plan = SearchPlan(tiles, self.settings.search_period, self.settings.urgent_search_period)
        self._book = TroubleBook(1.5 * self.settings.search_period)
        self._margin = 100.0
        self._light, self._light_stamp = "", 0
        self._turn = 0
        self._begun: int | None = None
        self._stamp = 0
        self._since = 0  # since when (ns) there are pictures without a gap
        self._searches = 0  # of the whole picture, with light

    def observe(self, picture: Picture, stamp: int) -> Observation:
        """Take the next picture: uint8 [H, W] or [H, W, 3] RGB, captured at stamp (ns). Never raises for what is in a picture."""
        if self._begun is None or stamp < self._stamp:
            self._start_clock(stamp)
        if self._begun == stamp or stamp - self._stamp > GAP:
            self._since = stamp
        self._stamp = stamp
        for robot in self._robots.values():
            robot.filter.predict(stamp)
            robot.missed += 1
        size = (self.calibration.width, self.calibration.height)
        if picture.ndim not in (2, 3) or (picture.shape[1], picture.shape[0]) != size:
            shape = f"{picture.shape[1]} x {picture.shape[0]}" if picture.ndim in (2, 3) else f"of {picture.ndim} dimensions"
            trouble = f"overhead picture is {shape}, the calibration is for {size[0]} x {size[1]}: set the camera, or calibrate"
            return self._observation((trouble,), False)
        for robot in self._robots.values():
            self._follow(robot, picture)
        self._visit_standing(picture)
        searched = self._search(picture)
        if not 0 <= stamp - self._light_stamp < self.settings.light_period * 1e9:
            self._light_stamp, self._light = stamp, light_trouble(picture)
        self._searches += searched and not self._light
        return self._observation(self._troubles(picture), searched)

    def _observation(self, troubles: tuple[str, ...], searched: bool) -> Observation:
        found = [
            (mount.tag, box_at(obstacle, standing.held))
            for obstacle, (mount, standing) in zip(self.table.obstacles, self._boxes, strict=True)
            if standing.held is not None
        ]
        unseen = any(standing.latest is None for _, standing in self._boxes)
        awaited = any(standing.latest is not None and standing.held is None for _, standing in self._boxes)
        known = self._searches > unseen and not awaited
        boxes, tags = tuple(box for _, box in found), tuple(tag for tag, _ in found)
        tracks = {name: robot.filter.state for name, robot in self._robots.items()}
        return Observation(tracks, boxes, tags, known, troubles, searched)

    def _start_clock(self, stamp: int) -> None:
        """Forget every stamp: the first picture, or one of a clock that went backwards."""
        self._begun = stamp
        for robot in self._robots.values():
            robot.last_seen = None
        for _, standing in self._standing:
            if standing.last_seen is not None:
                standing.last_seen = stamp

    def _find(self, picture: Picture, mount: TagMount, place: Floats, half: float) -> FoundTag | None:
        """Look for a tag within so many px of a place, float64 [2]."""
        window = clipped(place[0], place[1], half, self.calibration.width, self.calibration.height)
        found = [tag for tag in self._finder.find(picture, window, mount.half) if tag.id == mount.tag]
        if not found and mount.half:
            found = [tag for tag in self._finder.find(picture, window, False) if tag.id == mount.tag]
        return self._nearest(mount, found, place)

    def _nearest(self, mount: TagMount, found: list[FoundTag], place: Floats) -> FoundTag | None:
        """The one of some tags of one id that is nearest to where it is expected; the others are a trouble."""
        found = sorted(distinct(found), key=lambda tag: float(np.linalg.norm(tag.centre - place)))
        if len(found) > 1:
            self._note_twins(mount, [tag.centre for tag in found])
        return found[0] if found else None

    def _note_twins(self, mount: TagMount, centres: list[Floats]) -> None:
        self._book.note("twins", mount.name, twins_text(mount, centres, self.camera), self._stamp)

    def _measure(self, mount: TagMount, found: FoundTag) -> MeasuredPose | None:
        settings = self.settings
        try:
            return mount.measure(found, settings.corner_sigma, settings.scale_tolerance, settings.residual_limit)
        except NotAsMounted as error:
            self._book.note("unlike", mount.name, str(error), self._stamp)
            return None

    def _follow(self, robot: _Robot, picture: Picture) -> None:
        """Look for a robot's tag around its predicted place."""
        if not robot.filter.alive:
            return
        reach = 3 * robot.filter.spread * self.camera.scale_at(robot.mount.height) + self.settings.window_margin
        half = min(robot.mount.diagonal / 2 + reach, self.settings.largest_window)
        found = self._find(picture, robot.mount, robot.mount.place(robot.filter.pose), half)
        if found is not None:
            self._correct(robot, found)

    def _correct(self, robot: _Robot, found: FoundTag, certain: bool = False) -> None:
        """Take a sighting; one that is certain starts the track anew where the filter does not believe it."""
        measured = self._measure(robot.mount, found)
        if measured is None:
            return
        believed = robot.filter.correct(measured.pose, measured.covariance, self._stamp)
        if not believed and certain:
            robot.filter.end()
            believed = robot.filter.correct(measured.pose, measured.covariance, self._stamp)
        if believed:
            robot.missed, robot.last_seen, robot.last_place, robot.reason = 0, self._stamp, found.centre, None
            self._margin += 0.1 * (found.margin - self._margin)

    def _visit_standing(self, picture: Picture) -> None:
        """Look at one standing tag in its turn, and at those that have just been found or moved."""
        self._turn = (self._turn + 1) % len(self._standing)
        for index, (mount, standing) in enumerate(self._standing):
            unsettled = not standing.settled and self._unseen_for(standing) < 0.5
            if standing.latest is not None and (index == self._turn or unsettled):
                half = mount.diagonal / 2 + 2 * self.settings.window_margin
                found = self._find(picture, mount, mount.place(standing.latest), half)
                if found is not None:
                    self._see(mount, standing, found)
        for _, standing in self._boxes:
            missed = min(self._unseen_for(standing), (self._stamp - self._since) * 1e-9)  # not while there were no pictures
            if standing.latest is not None and missed > self.settings.keep_box:
                standing.forget()

    def _unseen_for(self, standing: StandingTag) -> float:
        since = standing.last_seen if standing.last_seen is not None else self._begun
        return (self._stamp - (since or 0)) * 1e-9

    def _see(self, mount: TagMount, standing: StandingTag, found: FoundTag) -> None:
        measured = self._measure(mount, found)
        if measured is not None:
            standing.see(measured.pose, self._stamp)

    def _search(self, picture: Picture) -> bool:
        """Search beyond the windows when it is time; returns whether that completed the picture."""
        robots = self._robots.values()
        urgent = any(not robot.filter.alive or robot.missed >= self.settings.missed_frames for robot in robots)
        whole = self._plan.whole_due(self._stamp, urgent)
        window: Window | None = (0, 0, self.calibration.width, self.calibration.height)
        completes = whole
        if not whole:
            window, completes = self._plan.tile_due(self._stamp)
        if window is None:
            return False
        by_id: dict[int, list[FoundTag]] = {}
        for tag in distinct(self._finder.find(picture, window, self._half_search)):
            by_id.setdefault(tag.id, []).append(tag)
        for robot in robots:
            self._take_robot(robot, by_id.get(robot.mount.tag, []), whole)
        for mount, standing in self._standing:
            self._take_standing(mount, standing, by_id.get(mount.tag, []))
        return completes

    def _take_robot(self, robot: _Robot, found: list[FoundTag], whole: bool) -> None:
        """Use what a search found of a robot's tag: a second one is a trouble, a missing one is found again."""
        if not found:
            return
        if robot.missed == 0:
            others = elsewhere(found, robot.last_place, robot.mount)
            if others:
                self._note_twins(robot.mount, [robot.last_place, *(tag.centre for tag in others)])
        elif whole and len(found) == 1:
            # Nothing at the predicted place and one in the whole picture: the robot was carried there.
            self._correct(robot, found[0], certain=True)
        elif robot.filter.alive:
            nearest = self._nearest(robot.mount, found, robot.mount.place(robot.filter.pose))
            if nearest is not None:
                self._correct(robot, nearest)
        elif len(found) > 1:
            self._note_twins(robot.mount, [tag.centre for tag in found])

    def _take_standing(self, mount: TagMount, standing: StandingTag, found: list[FoundTag]) -> None:
        """Use what a search found of a standing tag: a second one is a trouble, one carried elsewhere is followed."""
        if not found:
            return
        place = mount.place(standing.latest) if standing.latest is not None else None
        others = found if place is None else elsewhere(found, place, mount)
        if place is not None and others and self._unseen_for(standing) < 1.0:
            self._note_twins(mount, [place, *(tag.centre for tag in others)])
        elif len(found) > 1:
            self._note_twins(mount, [tag.centre for tag in found])
        elif others:
            self._see(mount, standing, others[0])

    def _troubles(self, picture: Picture) -> tuple[str, ...]:
        troubles = [self._light] if self._light else []
        for robot in self._robots.values():
            since = robot.last_seen if robot.last_seen is not None else self._begun or 0
            if robot.missed and self._stamp - since > self.settings.tell_after * 1e9:
                troubles.append(self._unseen(robot, picture))
        for mount, standing in self._standing:
            if self._unseen_for(standing) > self.settings.tell_standing_after:
                since_ = standing.last_seen
                troubles.append(f"{mount.name} " + (f"not seen since {clock(since_)}" if since_ else "was never seen"))
        for corner, (mount, standing) in zip(self.table.corners, self._corners, strict=True):
            off = 0.0 if standing.held is None else math.hypot(standing.held[0] - corner.x, standing.held[1] - corner.y)
            if off > self.settings.corner_moved:
                troubles.append(f"{mount.name} lies {1000 * off:.0f} mm from its place: camera or tag moved, calibrate again")
        troubles += self._book.standing(self._stamp)
        if self._margin < WEAK_MARGIN and not self._light:
            troubles.append(f"tags are hardly readable (margin {self._margin:.0f}): focus the lens, more light, less noise")
        return tuple(troubles)

    def _unseen(self, robot: _Robot, picture: Picture) -> str:
        """Say that a robot's tag is not seen, since when, and why as far as its last place shows."""
        if robot.last_seen is None:
            return f"{robot.mount.name} was never seen: is it in the picture, flat, and in the table's file?"
        if robot.reason is None:
            column, row = robot.last_place
            size = (self.calibration.width, self.calibration.height)
            robot.reason = why_unseen(grey_of(picture, clipped(column, row, 0.75 * robot.mount.width, *size)))
        return f"{robot.mount.name} not seen since {clock(robot.last_seen)}" + (f" ({robot.reason})" if robot.reason else "")
