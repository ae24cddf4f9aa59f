"""Messages as Rerun's archetypes, and the view that they are looked at in."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from schemas import (
    GOAL_COUNT,
    PRIMITIVES,
    ROBOTS,
    STATE_IMAGE_SIZE,
    ColorImage,
    Command,
    DepthImage,
    Layout,
    Message,
    Plan,
    Pose,
    PredictReply,
    PredictRequest,
    StateImage,
    Track,
)
from vantage.log.appearance import Appearance, row_repeats, value_picture
from vantage.log.target import optional
from vantage.log.words import words_of

_UNANSWERED = 64
_LEVELS = {"debug": "DEBUG", "info": "INFO", "warning": "WARN", "error": "ERROR"}


class Shown:
    """Logs messages as Rerun's archetypes.

    Attributes:
        entities: what was logged, by path.
    """

    def __init__(self, rerun: Any, recording: Any, looks: Appearance) -> None:
        self.entities: set[str] = set()
        self._rerun = rerun
        self._recording = recording
        self._looks = looks
        self._paths: dict[str, list[tuple[float, float]]] = {robot: [] for robot in ROBOTS}
        self._lenses: dict[str, Any] = {}
        self._asked: deque[PredictRequest] = deque(maxlen=_UNANSWERED)

    def begin(self) -> None:
        """Log what holds all the time."""
        rerun, looks = self._rerun, self._looks
        self._log("arena", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for robot in ROBOTS:
            classes = [
                (number, name, tuple(int(part) for part in color))
                for number, (name, color) in enumerate(zip(looks.view_names(robot), looks.view_palettes[robot], strict=True))
            ]
            self._log(f"views/{robot}", rerun.AnnotationContext(classes), static=True)
            color = looks.robot_colors[robot]
            body = rerun.Cylinders3D(
                lengths=[looks.robot_height],
                radii=[looks.robot_radius],
                centers=[(0, 0, looks.robot_height / 2)],
                colors=[color],
                labels=[robot],
                fill_mode="solid",
            )
            self._log(f"arena/{robot}/body", body, static=True)
            heading = rerun.Arrows3D(
                origins=[(0, 0, looks.robot_height)], vectors=[(1.6 * looks.robot_radius, 0, 0)], colors=[(20, 20, 20)]
            )
            self._log(f"arena/{robot}/heading", heading, static=True)
            self._log(f"motion/{robot}/x", rerun.SeriesLines(colors=[color], names=[f"{robot} x, m"]), static=True)
            pale = tuple((part + 255) // 2 for part in color)
            self._log(f"motion/{robot}/y", rerun.SeriesLines(colors=[pale], names=[f"{robot} y, m"]), static=True)

    def show(self, key: str, message: Message) -> None:
        """Log a message, at the times that are set."""
        robot = key.partition("/")[0]
        match message:
            case Layout():
                self._layout(message)
            case Pose():
                self._pose(robot, message)
            case Track():
                self._place(robot, message)
            case DepthImage():
                self._depth(robot, message)
            case ColorImage():
                self._color(robot, message)
            case StateImage():
                picture = np.frombuffer(message.data, np.uint8).reshape(STATE_IMAGE_SIZE, STATE_IMAGE_SIZE)
                self._log(f"views/{robot}", self._rerun.SegmentationImage(picture))
            case Command():
                self._log(f"{robot}/command", self._rerun.TextDocument(message.primitive))
                self._log(f"commands/{robot}", self._rerun.Scalars([PRIMITIVES.index(message.primitive)]))
            case Plan():
                self._plan(message)
            case PredictRequest():
                self._asked.append(message)
            case PredictReply():
                self._reply(message)
            case _:
                self._words(key, message)

    def _log(self, path: str, shown: Any, static: bool = False) -> None:
        self.entities.add(path)
        self._recording.log(path, shown, static=static)

    def _layout(self, layout: Layout) -> None:
        rerun = self._rerun
        thin = 0.002
        floor = rerun.Boxes3D(
            centers=[(layout.width / 2, layout.depth / 2, -thin)],
            half_sizes=[(layout.width / 2, layout.depth / 2, thin / 2)],
            colors=[self._looks.floor_color],
            fill_mode="solid",
        )
        self._log("arena/floor", floor)
        boxes = layout.obstacles
        obstacles = rerun.Boxes3D(
            centers=[(box.x, box.y, box.height / 2) for box in boxes],
            half_sizes=[(box.half_width, box.half_depth, box.height / 2) for box in boxes],
            quaternions=[_quaternion(box.heading) for box in boxes],
            colors=[self._looks.box_color] * len(boxes),
            fill_mode="solid",
        )
        self._log("arena/boxes", obstacles)

    def _place(self, robot: str, pose: Pose | Track) -> None:
        self._log(
            f"arena/{robot}", self._rerun.Transform3D(translation=(pose.x, pose.y, 0), quaternion=_quaternion(pose.heading))
        )

    def _pose(self, robot: str, pose: Pose) -> None:
        rerun = self._rerun
        self._place(robot, pose)
        self._log(f"motion/{robot}/x", rerun.Scalars([pose.x]))
        self._log(f"motion/{robot}/y", rerun.Scalars([pose.y]))
        self._log(f"headings/{robot}", rerun.Scalars([math.degrees(pose.heading)]))
        way = self._paths[robot]
        if way:
            # One piece a step, shown together by the view: a whole path every step would grow with the square of the steps.
            piece = [(*way[-1], 0.004), (pose.x, pose.y, 0.004)]
            color = self._looks.robot_colors[robot]  # type: ignore[index]
            self._log(f"arena/paths/{robot}", rerun.LineStrips3D([piece], colors=[color], radii=[0.004]))
        way[:] = [(pose.x, pose.y)]

    def _depth(self, robot: str, message: DepthImage) -> None:
        rerun, lens = self._rerun, message.intrinsics
        camera = f"arena/{robot}/camera"
        if self._lenses.get(robot) != lens:
            self._lenses[robot] = lens
            # The optical frame: z forward, x right, y down.
            mount = rerun.Transform3D(
                translation=(0, 0, lens.mount_height), quaternion=rerun.Quaternion(xyzw=(-0.5, 0.5, -0.5, 0.5))
            )
            pinhole = rerun.Pinhole(
                resolution=(message.width, message.height),
                focal_length=(lens.fx, lens.fy),
                principal_point=(lens.cx, lens.cy),
                image_plane_distance=0.1,
            )
            self._log(camera, mount)
            self._log(f"{camera}/picture", pinhole)
        distances = np.frombuffer(message.data, "<u2").reshape(message.height, message.width)
        self._log(f"{camera}/picture/depth", rerun.DepthImage(distances, meter=1000.0))

    def _color(self, robot: str, message: ColorImage) -> None:
        pixels = np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, 3)
        repeats = row_repeats(message.height)
        if repeats > 1:
            self._log(f"pictures/{robot}", self._rerun.Image(np.repeat(pixels, repeats, axis=0)))
        else:
            self._log(f"arena/{robot}/camera/picture/color", self._rerun.Image(pixels))

    def _plan(self, plan: Plan) -> None:
        rerun = self._rerun
        if len(plan.values) == GOAL_COUNT:
            self._log("value-map", rerun.Image(value_picture(plan.values, plan.goal, self._looks)))
        path = np.frombuffer(plan.path, np.float32).reshape(-1, 3)
        path = path[np.isfinite(path).all(axis=1)]
        if len(path):
            points = np.column_stack((path[:, :2], np.full(len(path), 0.006)))
            color = (*self._looks.robot_colors["hider"], 140)
            self._log("arena/plan", rerun.LineStrips3D([points], colors=[color], radii=[0.003]))

    def _reply(self, reply: PredictReply) -> None:
        rerun = self._rerun
        caught = np.frombuffer(reply.caught, np.float32)
        request = next((one for one in self._asked if one.path_count * len(one.horizons) == len(caught)), None)
        if request is not None:
            self._asked.remove(request)
            risk = caught.reshape(request.path_count, len(request.horizons))
            self._log("risk/lowest-of-all-goals", rerun.Scalars([float(risk.mean(axis=1).min())]))
            self._log("risk/mean-of-all-goals", rerun.Scalars([float(risk.mean())]))
        if reply.views:
            views = [np.frombuffer(view, np.uint8).reshape(STATE_IMAGE_SIZE, STATE_IMAGE_SIZE, 3) for view in reply.views]
            self._log("predicted-views", rerun.Image(self._looks.predicted_view(np.concatenate(views, axis=1))))

    def _words(self, key: str, message: Message) -> None:
        words = words_of(key, message)
        if words is not None:
            self._log("text", self._rerun.TextLog(f"{words.name}: {words.text}", level=_LEVELS[words.level]))


def _quaternion(heading: float) -> Any:
    """xyzw of a turn about z."""
    rerun = optional("rerun", "rerun-sdk")
    return rerun.Quaternion(xyzw=(0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2)))


def view_of(blueprint: Any, entities: set[str]) -> Any:
    """The view: the scene, each robot's pictures, what the hider thinks, curves and texts; only of what is there."""
    start, end = blueprint.TimeRangeBoundary.infinite(), blueprint.TimeRangeBoundary.cursor_relative()
    up_to_now = blueprint.VisibleTimeRanges(
        [blueprint.VisibleTimeRange(timeline, start=start, end=end) for timeline in ("step", "recorded", "captured")]
    )
    paths = [f"/arena/paths/{robot}" for robot in ROBOTS if f"arena/paths/{robot}" in entities]
    scene = blueprint.Spatial3DView(
        origin="/arena",
        contents=["/arena/**", *(f"- /arena/{robot}/camera/picture/color" for robot in ROBOTS)],
        name="arena",
        overrides=dict.fromkeys(paths, up_to_now),
    )
    rows = []
    for robot in ROBOTS:
        row = [
            blueprint.Spatial2DView(origin=f"/{path}", contents=["$origin/**"], name=f"{robot}: {name}")
            for path, name in (
                (f"pictures/{robot}", "colour"),
                (f"arena/{robot}/camera/picture/color", "colour"),
                (f"arena/{robot}/camera/picture/depth", "depth"),
                (f"views/{robot}", "state image"),
            )
            if path in entities
        ]
        if row:
            rows.append(blueprint.Horizontal(*row))
    thoughts = [
        blueprint.Spatial2DView(origin=f"/{path}", name=name)
        for path, name in (
            ("value-map", "danger of each goal"),
            ("predicted-views", "predicted seeker views"),
        )
        if path in entities
    ]
    if thoughts:
        rows.append(blueprint.Horizontal(*thoughts))
    below = [
        blueprint.TimeSeriesView(origin=f"/{path}", name=name)
        for path, name in (("motion", "x and y, m"), ("risk", "danger: probability to be caught"), ("commands", "primitives"))
        if any(entity.startswith(path) for entity in entities)
    ]
    if "text" in entities:
        below.append(blueprint.TextLogView(origin="/text", name="what was said"))
    upper = blueprint.Horizontal(scene, blueprint.Vertical(*rows), column_shares=[1, 1]) if rows else scene
    return blueprint.Blueprint(
        blueprint.Vertical(upper, blueprint.Horizontal(*below), row_shares=[3, 1]),
        blueprint.TimePanel(state="expanded", timeline="captured"),
        blueprint.SelectionPanel(state="collapsed"),
        blueprint.BlueprintPanel(state="collapsed"),
    )
