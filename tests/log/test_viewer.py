"""Viewer channels: decoded here by the independent protobuf support of mcap, from the schemas in the file."""

from __future__ import annotations

import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from schemas import (
    GOAL_COUNT,
    TOPICS,
    Box,
    ColorImage,
    DepthImage,
    Gap,
    Intrinsics,
    Layout,
    Message,
    Plan,
    Pose,
    PredictReply,
    StateImage,
    encode,
)
from services.recorder.appearance import arena_appearance
from tests.golden.make_log import GOLDEN, example
from tests.log.making import game, records_of, write_log
from vantage.log import LogWriter, RunMetadata, read
from vantage.log.export import export
from vantage.log.reader import NoSuchLog
from vantage.log.viewer import Viewer, value_picture
from vantage.perception.palette import DANGER, FREE, OTHER, OWN, PALETTE

STAMP = 1_700_000_000_123_456_789


def shown(tmp_path: Path, *messages: tuple[str, Message]) -> dict[str, list[Any]]:
    """What viewers see of messages: topic -> decoded protobuf."""
    tmp_path.mkdir(exist_ok=True)
    path = tmp_path / f"{len(list(tmp_path.iterdir()))}.mcap"
    with LogWriter(path, RunMetadata(), sync=False, viewer=Viewer(arena_appearance()).translate) as log:
        for number, (key, message) in enumerate(messages):
            log.write(key, encode(message), log_time=number + 1, publish_time=7, sequence=number, publisher="x")
    found: dict[str, list[Any]] = defaultdict(list)
    with path.open("rb") as file:
        for schema, channel, message, decoded in make_reader(
            file, validate_crcs=True, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages(topics=_viewer_topics(path)):
            assert schema.name.startswith("foxglove.")
            assert channel.message_encoding == "protobuf"
            assert message.publish_time == 7
            found[channel.topic.removeprefix("viewer/")].append(decoded)
    return found


def _viewer_topics(path: Path) -> list[str]:
    return sorted({record.key for record in read(path, viewer=True) if record.key.startswith("viewer/")})


def picture(image: Any) -> np.ndarray:
    assert image.encoding == "rgb8"
    return np.frombuffer(image.data, np.uint8).reshape(image.height, image.step // 3, 3)


def test_a_pose_is_a_pose_and_a_frame(tmp_path: Path) -> None:
    found = shown(tmp_path, ("seeker/pose", Pose(stamp=STAMP, x=0.25, y=0.75, heading=math.pi / 2)))
    (pose,), (frame,) = found["seeker/pose"], found["frames"]
    assert (pose.frame_id, pose.pose.position.x, pose.pose.position.y) == ("arena", 0.25, 0.75)
    assert (pose.timestamp.seconds, pose.timestamp.nanos) == (1_700_000_000, 123_456_789)
    assert (frame.parent_frame_id, frame.child_frame_id, frame.translation.x) == ("arena", "seeker", 0.25)
    turned = 2 * math.atan2(frame.rotation.z, frame.rotation.w)
    assert turned == pytest.approx(math.pi / 2)


def test_camera_pictures(tmp_path: Path) -> None:
    lens = Intrinsics(fx=30.0, fy=31.0, cx=19.5, cy=20.5, mount_height=0.08)
    depth = np.arange(40 * 42, dtype="<u2")
    colors = np.arange(40 * 42 * 3, dtype=np.uint8)
    found = shown(
        tmp_path,
        ("hider/depth", DepthImage(stamp=STAMP, width=40, height=42, intrinsics=lens, data=depth.tobytes())),
        ("hider/color", ColorImage(stamp=STAMP, width=40, height=42, intrinsics=lens, data=colors.tobytes())),
    )
    (image,) = found["hider/depth"]
    assert (image.encoding, image.width, image.height, image.step, image.frame_id) == ("16UC1", 40, 42, 80, "hider/camera")
    assert image.data == depth.tobytes()
    assert found["hider/color"][0].data == colors.tobytes()
    assert list(found["hider/calibration"][0].K) == [30.0, 0.0, 19.5, 0.0, 31.0, 20.5, 0.0, 0.0, 1.0]
    # The camera looks along the robot's x: its own z axis, turned, is the robot's x axis; its x is the robot's right.
    turn = found["frames"][0].rotation
    assert _rotate(turn, (0.0, 0.0, 1.0)) == pytest.approx((1.0, 0.0, 0.0))
    assert _rotate(turn, (1.0, 0.0, 0.0)) == pytest.approx((0.0, -1.0, 0.0))
    assert found["frames"][0].translation.z == pytest.approx(0.08)


def _rotate(q: Any, v: tuple[float, float, float]) -> tuple[float, ...]:
    axis, vector = np.array([q.x, q.y, q.z]), np.array(v)
    return tuple(vector + 2 * np.cross(axis, np.cross(axis, vector) + q.w * vector))


def test_the_one_row_camera_is_tall_enough_to_be_seen(tmp_path: Path) -> None:
    lens = Intrinsics(fx=4.0, fy=4.0, cx=3.5, cy=0.0)
    row = bytes(range(24))
    found = shown(tmp_path, ("hider/color", ColorImage(stamp=STAMP, width=8, height=1, intrinsics=lens, data=row)))
    image = found["hider/color"][0]
    assert (image.width, image.height) == (8, 32)
    assert image.data == row * 32


def test_large_pictures_can_be_thinned_out() -> None:
    lens = Intrinsics(fx=300.0, fy=300.0, cx=319.5, cy=239.5)
    viewer, whole = Viewer(arena_appearance(), picture_rate=5.0), Viewer(arena_appearance())
    small = StateImage(stamp=0, data=bytes(128 * 128))
    shown = every = 0
    for number in range(90):
        stamp = STAMP + number * 40_000_000
        picture = encode(ColorImage(stamp=stamp, width=640, height=480, intrinsics=lens, data=bytes(640 * 480 * 3)))
        shown += len(viewer.translate("hider/color", picture))
        every += len(whole.translate("hider/color", picture))
        assert len(viewer.translate("hider/view", encode(small))) == 1
    assert (shown, every) == (18, 90)
    # A clock that was set back does not stop the pictures.
    early = encode(ColorImage(stamp=5, width=640, height=480, intrinsics=lens, data=bytes(640 * 480 * 3)))
    assert len(viewer.translate("hider/color", early)) == 1


def test_state_images_have_the_palettes_colours_and_each_robot_its_own(tmp_path: Path) -> None:
    indices = (np.arange(128 * 128) % 5).astype(np.uint8).reshape(128, 128)
    looks = arena_appearance()
    for robot, own, other in (("hider", "hider", "seeker"), ("seeker", "seeker", "hider")):
        found = shown(tmp_path / robot, (f"{robot}/view", StateImage(stamp=STAMP, data=indices.tobytes())))
        image = picture(found[f"{robot}/view"][0])
        assert np.array_equal(image[indices < OWN], PALETTE[indices[indices < OWN]])
        assert (image[indices == OWN] == looks.robot_colors[own]).all()  # type: ignore[index]
        assert (image[indices == OTHER] == looks.robot_colors[other]).all()  # type: ignore[index]
    nonsense = StateImage(stamp=STAMP, data=bytes([250]) * 128 * 128)
    assert len(shown(tmp_path, ("hider/view", nonsense))["hider/view"]) == 1


def test_the_scene_has_boxes_where_they_stand(tmp_path: Path) -> None:
    box = Box(x=0.4, y=0.7, half_width=0.1, half_depth=0.05, heading=0.5, height=0.2)
    (scene,) = shown(tmp_path, ("layout", Layout(stamp=STAMP, obstacles=(box,))))["scene"]
    entities = {entity.id: entity for entity in scene.entities}
    assert set(entities) == {"layout", "hider", "seeker"}
    floor, cube = entities["layout"].cubes
    assert (floor.size.x, floor.size.y, floor.pose.position.x) == (1.2, 1.2, 0.6)
    assert (cube.pose.position.x, cube.pose.position.y, cube.pose.position.z) == (0.4, 0.7, 0.1)
    assert (cube.size.x, cube.size.y, cube.size.z) == (0.2, 0.1, 0.2)
    body = entities["seeker"].cylinders[0]
    assert entities["seeker"].frame_id == "seeker"
    assert entities["seeker"].frame_locked
    assert body.size.x == pytest.approx(0.13)


def test_the_value_map_is_a_grid_and_a_picture(tmp_path: Path) -> None:
    values = tuple(None if goal == 60 else float(goal) for goal in range(GOAL_COUNT))
    path = np.array([[0.1, 0.2, 0.0], [0.3, 0.4, 0.0]], "<f4")
    found = shown(tmp_path, ("hider/plan", Plan(stamp=STAMP, horizon=100, values=values, goal=13, path=path.tobytes())))
    (grid,) = found["hider/plan/values"]
    held = np.frombuffer(grid.data, "<f4").reshape(11, grid.column_count)
    assert (grid.row_stride, grid.cell_size.x, grid.fields[0].name) == (44, pytest.approx(0.1), "danger")
    assert held[1, 2] == 13
    assert np.isnan(held[5, 5])
    # A cell's centre is its goal: the corner lies half a cell before goal 0 at (0.1, 0.1).
    assert grid.pose.position.x == pytest.approx(0.05)
    image = picture(found["hider/plan/picture"][0])
    assert image.shape == (220, 220, 3)
    assert np.array_equal(image, value_picture(values, 13, arena_appearance()))
    assert tuple(image[110, 110]) == (128, 128, 128)  # goal 60, the middle, is blocked
    assert tuple(image[219 - 10, 10]) == tuple(DANGER[0])  # goal 0, near left, is the safest
    assert tuple(image[10, 219 - 10]) == tuple(DANGER[-1])  # goal 120, far right, is the most dangerous
    assert tuple(image[219 - 21, 2 * 20 + 1]) == (0, 0, 0)  # the chosen goal's frame: row 1, column 2
    line = found["hider/plan/path"][0].entities[0].lines[0]
    assert [(point.x, point.y) for point in line.points] == [tuple(map(float, row[:2])) for row in path]


def test_a_plan_without_values_shows_its_path_only(tmp_path: Path) -> None:
    found = shown(tmp_path, ("hider/plan", Plan(stamp=STAMP, horizon=10)))
    assert set(found) == {"hider/plan/path"}


def test_predicted_views_stand_side_by_side(tmp_path: Path) -> None:
    free, own, other = [PALETTE[index].tobytes() * (128 * 128) for index in (FREE, OWN, OTHER)]
    reply = PredictReply(stamp=STAMP, caught=b"", views=(free, own, other))
    image = picture(shown(tmp_path, ("predictor/reply", reply))["predictor/views"][0])
    assert image.shape == (128, 384, 3)
    assert (image[:, :128] == 255).all()
    assert (image[:, 128:256] == arena_appearance().robot_colors["seeker"]).all(), "whose view it is"
    assert (image[:, 256:] == arena_appearance().robot_colors["hider"]).all()


def test_words_are_said(tmp_path: Path) -> None:
    gap = Gap(stamp=STAMP, key="hider/pose", publisher="simulator", missed=3)
    found = shown(tmp_path, ("episode", example("episode", 1)), ("health/seeker", example("health/seeker", 0)), ("gap", gap))
    assert [(entry.name, entry.message) for entry in found["text"]] == [
        ("referee", "episode 3 (seed 42) ended: caught caught at 0.149 m"),
        ("seeker", "degraded hider/pose from simulator is 5.0 s old, expected 4 a second"),
        ("recorder", "3 messages of hider/pose from simulator lost"),
    ]


def test_every_topic_of_interest_is_shown_and_nonsense_is_not() -> None:
    viewer = Viewer(arena_appearance())
    unseen = {key for key in TOPICS if not viewer.translate(key, encode(example(key, 0)))}
    per_robot = {f"{robot}/{part}" for robot in ("hider", "seeker") for part in ("command",)}
    assert unseen == {"tick", "predictor/request", *per_robot}
    assert viewer.translate("hider/pose", b"nonsense") == []
    assert viewer.translate("stranger", b"") == []


def test_export_keeps_every_message_and_adds_what_viewers_show(tmp_path: Path) -> None:
    source, target = GOLDEN / "log_v1.mcap", tmp_path / "viewer.mcap"
    count, breaks = export(source, target, Viewer(arena_appearance()))
    assert breaks == []
    records = list(read(source))
    assert count == len(records)
    assert list(read(target)) == records
    both = list(read(target, viewer=True))
    assert len(both) > len(records)
    with target.open("rb") as file:
        metadata = next(make_reader(file).iter_metadata()).metadata
    assert metadata["commit"] == "golden"


def test_export_joins_parts_and_refuses_several_logs(tmp_path: Path) -> None:
    records = records_of(game(1, 30))
    (tmp_path / "runs").mkdir()
    write_log(tmp_path / "runs" / "a.mcap", records, split_seconds=0.1)
    export(tmp_path / "runs", tmp_path / "one.mcap", Viewer(arena_appearance()))
    assert list(read(tmp_path / "one.mcap")) == records
    write_log(tmp_path / "runs" / "b.mcap", records)
    with pytest.raises(NoSuchLog, match="holds 2 logs"):
        export(tmp_path / "runs", tmp_path / "two.mcap", Viewer(arena_appearance()))
