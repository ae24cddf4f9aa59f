"""Messages as Foxglove, Lichtblick and Rerun know them: Foxglove's protobuf schemas, as extra channels of a log."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import numpy as np
from foxglove import messages as fox

from schemas import (
    GOAL_COUNT,
    ROBOTS,
    STATE_IMAGE_SIZE,
    TOPICS,
    ColorImage,
    Control,
    DepthImage,
    Episode,
    Gap,
    Health,
    Layout,
    MalformedMessage,
    Message,
    Motion,
    Plan,
    Playback,
    Pose,
    PredictReply,
    Robot,
    StateImage,
    Track,
    decode,
)
from vantage.log.appearance import GOALS_A_SIDE, Appearance, value_picture
from vantage.log.foxglove_messages import calibration_of, camera_image_of, colored, image_of, placed, time_of, turned
from vantage.log.words import words_of

__all__ = ["Appearance", "Viewer", "ViewerMessage", "value_picture"]

ARENA_FRAME = "arena"
_GOAL_SPACING = 0.1  # m; as Plan.values describes it
_LARGE = 256 * 1024
_LEVELS = {
    "debug": fox.LogLevel.Debug,
    "info": fox.LogLevel.Info,
    "warning": fox.LogLevel.Warning,
    "error": fox.LogLevel.Error,
}


class ViewerMessage(NamedTuple):
    """A message for viewers.

    Attributes:
        topic: below `viewer/`.
        schema_name, schema: Foxglove's name, and the serialised FileDescriptorSet.
        payload: protobuf.
    """

    topic: str
    schema_name: str
    schema: bytes
    payload: bytes


_schemas: dict[str, tuple[str, bytes]] = {}


def _as_viewer_message(topic: str, message: Any) -> ViewerMessage:
    kind = type(message).__name__
    known = _schemas.get(kind)
    if known is None:
        schema = message.get_schema()
        known = _schemas[kind] = (schema.name, schema.data)
    return ViewerMessage(topic, *known, message.encode())


class Viewer:
    """Translates messages of the bus; see `translate`."""

    def __init__(self, appearance: Appearance, picture_rate: float | None = None) -> None:
        """Args:
        appearance: what things look like.
        picture_rate: of pictures above 256 KiB, show at most so many a second of each topic (a recorder that copies two
            640 x 480 RGB-D streams at 30 Hz a second time works twice as hard); None: show all.
        """
        self.appearance = appearance
        self._picture_period = 0 if picture_rate is None else round(1e9 / picture_rate)
        self._last_shown: dict[str, int] = {}
        self._playback: tuple[object, ...] = ()
        self._translations: dict[type[Message], Callable[[str, Any], list[tuple[str, Any]]]] = {
            Pose: self._pose,
            Track: self._pose,
            Motion: self._text,
            DepthImage: self._depth,
            ColorImage: self._picture,
            StateImage: self._state_image,
            Layout: self._layout,
            Plan: self._plan,
            PredictReply: self._predicted_views,
            Episode: self._text,
            Health: self._text,
            Gap: self._text,
            Control: self._text,
            Playback: self._playback_text,
        }

    def translate(self, key: str, payload: bytes) -> list[ViewerMessage]:
        """Return what viewers shall see of a message; nothing for a key or bytes that mean nothing to them."""
        topic = TOPICS.get(key)
        translation = self._translations.get(topic.type) if topic else None
        if topic is None or translation is None:
            return []
        try:
            message = decode(topic.type, payload)
        except MalformedMessage:
            return []
        if len(payload) > _LARGE and self._picture_period:
            since = message.stamp - self._last_shown.get(key, -self._picture_period)
            if 0 <= since < self._picture_period:
                return []
            self._last_shown[key] = message.stamp
        return [_as_viewer_message(name, shown) for name, shown in translation(key, message)]

    def _pose(self, key: str, message: Pose | Track) -> list[tuple[str, Any]]:
        robot = key.partition("/")[0]
        shown = fox.PoseInFrame(
            timestamp=time_of(message), frame_id=ARENA_FRAME, pose=placed(message.x, message.y, 0.0, message.heading)
        )
        frame = fox.FrameTransform(
            timestamp=time_of(message),
            parent_frame_id=ARENA_FRAME,
            child_frame_id=robot,
            translation=fox.Vector3(x=message.x, y=message.y, z=0.0),
            rotation=turned(message.heading),
        )
        return [(key, shown), ("frames", frame)]

    def _depth(self, key: str, message: DepthImage) -> list[tuple[str, Any]]:
        robot = key.partition("/")[0]
        # The optical frame: z forward, x right, y down.
        camera = fox.FrameTransform(
            timestamp=time_of(message),
            parent_frame_id=robot,
            child_frame_id=f"{robot}/camera",
            translation=fox.Vector3(x=0.0, y=0.0, z=message.intrinsics.mount_height),
            rotation=fox.Quaternion(x=-0.5, y=0.5, z=-0.5, w=0.5),
        )
        return [
            (key, camera_image_of(message, robot, "16UC1", 2)),
            (f"{robot}/calibration", calibration_of(message, robot, message.intrinsics)),
            ("frames", camera),
        ]

    def _picture(self, key: str, message: ColorImage) -> list[tuple[str, Any]]:
        return [(key, camera_image_of(message, key.partition("/")[0], "rgb8", 3))]

    def _state_image(self, key: str, message: StateImage) -> list[tuple[str, Any]]:
        indices = np.frombuffer(message.data, np.uint8).reshape(STATE_IMAGE_SIZE, STATE_IMAGE_SIZE)
        robot = cast(Robot, key.partition("/")[0])
        return [(key, image_of(message, ARENA_FRAME, self.appearance.view_picture(indices, robot)))]

    def _layout(self, _key: str, message: Layout) -> list[tuple[str, Any]]:
        thin = 0.002
        floor = fox.CubePrimitive(
            pose=placed(message.width / 2, message.depth / 2, -thin),
            size=fox.Vector3(x=message.width, y=message.depth, z=thin),
            color=colored(*self.appearance.floor_color),
        )
        boxes = [
            fox.CubePrimitive(
                pose=placed(box.x, box.y, box.height / 2, box.heading),
                size=fox.Vector3(x=2 * box.half_width, y=2 * box.half_depth, z=box.height),
                color=colored(*self.appearance.box_color),
            )
            for box in message.obstacles
        ]
        entities = [fox.SceneEntity(timestamp=time_of(message), frame_id=ARENA_FRAME, id="layout", cubes=[floor, *boxes])]
        looks = self.appearance
        for robot in ROBOTS:
            body = fox.CylinderPrimitive(
                pose=placed(0.0, 0.0, looks.robot_height / 2),
                size=fox.Vector3(x=2 * looks.robot_radius, y=2 * looks.robot_radius, z=looks.robot_height),
                bottom_scale=1.0,
                top_scale=1.0,
                color=colored(*looks.robot_colors[robot]),
            )
            nose = fox.ArrowPrimitive(
                pose=placed(0.0, 0.0, looks.robot_height),
                shaft_length=looks.robot_radius,
                shaft_diameter=0.012,
                head_length=0.03,
                head_diameter=0.03,
                color=colored(20, 20, 20),
            )
            entity = fox.SceneEntity(
                timestamp=time_of(message), frame_id=robot, id=robot, frame_locked=True, cylinders=[body], arrows=[nose]
            )
            entities.append(entity)
        return [("scene", fox.SceneUpdate(entities=entities))]

    def _plan(self, key: str, message: Plan) -> list[tuple[str, Any]]:
        shown: list[tuple[str, Any]] = []
        if len(message.values) == GOAL_COUNT:
            values = np.array([np.nan if value is None else value for value in message.values], np.float32)
            grid = fox.Grid(
                timestamp=time_of(message),
                frame_id=ARENA_FRAME,
                pose=placed(_GOAL_SPACING / 2, _GOAL_SPACING / 2, 0.001),
                column_count=GOALS_A_SIDE,
                cell_size=fox.Vector2(x=_GOAL_SPACING, y=_GOAL_SPACING),
                row_stride=4 * GOALS_A_SIDE,
                cell_stride=4,
                fields=[fox.PackedElementField(name="danger", offset=0, type=fox.PackedElementFieldNumericType.Float32)],
                data=values.tobytes(),
            )
            shown.append((f"{key}/values", grid))
            picture = value_picture(message.values, message.goal, self.appearance)
            shown.append((f"{key}/picture", image_of(message, ARENA_FRAME, picture)))
        path = np.frombuffer(message.path, np.float32).reshape(-1, 3)
        line = fox.LinePrimitive(
            type=fox.LinePrimitiveLineType.LineStrip,
            thickness=0.008,
            points=[fox.Point3(x=float(x), y=float(y), z=0.005) for x, y, _ in path if math.isfinite(x) and math.isfinite(y)],
            color=colored(*self.appearance.robot_colors["hider"], 0.9),
        )
        entity = fox.SceneEntity(timestamp=time_of(message), frame_id=ARENA_FRAME, id="plan", lines=[line])
        shown.append((f"{key}/path", fox.SceneUpdate(entities=[entity])))
        return shown

    def _predicted_views(self, _key: str, message: PredictReply) -> list[tuple[str, Any]]:
        if not message.views:
            return []
        views = [np.frombuffer(view, np.uint8).reshape(STATE_IMAGE_SIZE, STATE_IMAGE_SIZE, 3) for view in message.views]
        shown = self.appearance.predicted_view(np.concatenate(views, axis=1))
        return [("predictor/views", image_of(message, ARENA_FRAME, shown))]

    def _text(self, key: str, message: Message) -> list[tuple[str, Any]]:
        words = words_of(key, message)
        if words is None:
            return []
        return [("text", fox.Log(timestamp=time_of(message), level=_LEVELS[words.level], name=words.name, message=words.text))]

    def _playback_text(self, key: str, message: Playback) -> list[tuple[str, Any]]:
        """Said twice a second; shown when something changed."""
        state = (message.log, message.state, message.speed, message.jumps)
        if state == self._playback:
            return []
        self._playback = state
        return self._text(key, message)
