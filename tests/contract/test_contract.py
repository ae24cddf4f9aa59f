"""What whoever embodies the robots owes the rest, be it the simulator or a real table: the same tests for both."""

from __future__ import annotations

import math

import numpy as np
import pytest

from schemas import ROBOTS, ColorImage, DepthImage, Layout, Pose, Tick
from tests.contract.tables import RehearsedTable, SimulatedTable, TableOnTest
from vantage.perception.state_image import perceive
from vantage.world.arena import ROBOT_RADIUS
from vantage.world.layout import boxes_of, check_layout
from vantage.world.motion import is_free, line_of_sight

Table = SimulatedTable | RehearsedTable
PICTURES = ("depth", "color")


def test_a_setup_is_answered_with_the_layout_then_pictures_then_poses(table: Table) -> None:
    table.begin(1)
    keys = [sample.key for sample in table.said if sample.decode().episode == 1 and not sample.key.endswith(("track", "motion"))]
    assert keys[0] == "layout"
    rest = [key for key in keys if key != "layout"]
    assert set(rest[:4]) == {f"{robot}/{part}" for robot in ROBOTS for part in PICTURES}
    assert rest[4:] == ["hider/pose", "seeker/pose"]


def test_the_layout_is_one_that_can_be_played_in(table: Table) -> None:
    table.begin(1)
    table.move(1, 0, "left", "right")
    layouts = table.messages("layout", 1)
    assert layouts
    for layout in layouts:
        assert isinstance(layout, Layout)
        assert (layout.width, layout.depth) == (1.2, 1.2)
        assert len(layout.obstacles) == 3
        check_layout(layout.obstacles, layout.width, layout.depth)
    assert len({layout.obstacles for layout in layouts}) == 1  # of one game: starts and ways are drawn from the first


def test_the_robots_start_free_in_sight_of_each_other_and_face_to_face(table: Table) -> None:
    table.begin(1, start_distance_minimum=0.25, start_distance_maximum=0.45)
    layout = table.messages("layout", 1)[-1]
    hider, seeker = table.poses(1, 0)
    boxes = boxes_of(layout)
    for pose in (hider, seeker):
        assert is_free(boxes, layout.width, layout.depth, pose.x, pose.y, ROBOT_RADIUS - table.place_error)
    assert line_of_sight(boxes, hider.x, hider.y, seeker.x, seeker.y)
    distance = math.hypot(hider.x - seeker.x, hider.y - seeker.y)
    assert 0.25 - 2 * table.place_error <= distance <= 0.45 + 2 * table.place_error
    for one, other in ((hider, seeker), (seeker, hider)):
        toward = math.atan2(other.y - one.y, other.x - one.x)
        assert abs(math.remainder(one.heading - toward, math.tau)) <= math.radians(5.0) + 0.03 + table.angle_error


def test_pictures_are_registered_pinholes_in_the_units_of_the_contract(table: Table) -> None:
    table.begin(1)
    for robot in ROBOTS:
        depth, color = (table.step_of(f"{robot}/{part}", 1, 0) for part in PICTURES)
        assert isinstance(depth, DepthImage) and isinstance(color, ColorImage)
        assert (depth.width, depth.height) == (color.width, color.height) == (160, 120)
        assert depth.intrinsics == color.intrinsics
        assert depth.intrinsics.mount_height == pytest.approx(0.08, abs=0.002)
        assert depth.intrinsics.fx == pytest.approx(160 / 2 / math.tan(math.radians(43.0)), rel=1e-3)
        millimetres = np.frombuffer(depth.data, "<u2")
        assert 40 < np.median(millimetres[millimetres > 0]) < 1500
        assert np.mean(millimetres > 0) > 0.5


def test_each_robot_sees_the_other_where_it_is(table: Table) -> None:
    """Through the players' own perception: right only if frames, units, colours and registration all are."""
    table.begin(1)
    poses = table.poses(1, 0)
    for index, robot in enumerate(ROBOTS):
        depth, color = (table.step_of(f"{robot}/{part}", 1, 0) for part in PICTURES)
        view = perceive(depth, color, poses[index], robot)
        other = poses[1 - index]
        assert view.other is not None, robot
        assert math.hypot(view.other[0] - other.x, view.other[1] - other.y) < 0.015


def test_a_command_moves_its_robot_and_no_other(table: Table) -> None:
    table.begin(1)
    before = table.poses(1, 0)
    table.move(1, 0, "backward", "stay")
    table.move(1, 1, "stay", "left")
    table.move(1, 2, "right", "backward")
    after = [table.poses(1, step) for step in (1, 2, 3)]
    cosine, sine = math.cos(before[0].heading), math.sin(before[0].heading)
    gone = (after[0][0].x - before[0].x, after[0][0].y - before[0].y)
    assert gone[0] * cosine + gone[1] * sine == pytest.approx(-0.010, abs=2 * table.place_error)
    assert -gone[0] * sine + gone[1] * cosine == pytest.approx(0.0, abs=2 * table.place_error)
    turned = math.remainder(after[1][1].heading - before[1].heading, math.tau)
    assert turned == pytest.approx(math.radians(10.0), abs=2 * table.angle_error)
    for stayed, place in ((after[0][1], before[1]), (after[1][0], after[0][0])):
        assert math.hypot(stayed.x - place.x, stayed.y - place.y) <= 2 * table.place_error
    assert math.remainder(after[2][0].heading - after[1][0].heading, math.tau) == pytest.approx(
        -math.radians(10.0), abs=2 * table.angle_error
    )


def test_steps_follow_on_each_other_and_stamps_too(table: Table) -> None:
    table.begin(1)
    for step in range(4):
        table.move(1, step, "left", "right")
    for key in (f"{robot}/{part}" for robot in ROBOTS for part in (*PICTURES, "pose")):
        messages = table.messages(key, 1)
        assert [message.step for message in messages] == [0, 1, 2, 3, 4]
        stamps = [message.stamp for message in messages]
        assert stamps == sorted(stamps)


def test_nothing_of_a_step_was_captured_before_its_command(table: Table) -> None:
    table.begin(1)
    asked = table.clock()
    table.move(1, 0, "left", "backward")
    for robot in ROBOTS:
        for part in (*PICTURES, "pose"):
            assert asked <= table.step_of(f"{robot}/{part}", 1, 1).stamp <= table.clock()
    motions = [table.step_of(f"{robot}/motion", 1, 1) for robot in ROBOTS if table.messages(f"{robot}/motion", 1)]
    for motion in motions:
        for robot in ROBOTS:
            for part in (*PICTURES, "pose"):
                assert table.step_of(f"{robot}/{part}", 1, 1).stamp > motion.stamp


def test_a_robot_named_late_stays(table: Table) -> None:
    table.begin(1)
    before = table.poses(1, 0)
    table.command(1, 0, seeker="right")
    assert not table.run(lambda: table.has_step(1, 1), 1.0)
    table.publish("referee", "tick", Tick(stamp=table.clock(), episode=1, step=0, late=("hider",)))
    assert table.run(lambda: table.has_step(1, 1), 3.0), table.troubles()
    hider, seeker = table.poses(1, 1)
    assert math.hypot(hider.x - before[0].x, hider.y - before[0].y) <= 2 * table.place_error
    assert abs(math.remainder(seeker.heading - before[1].heading, math.tau)) == pytest.approx(
        math.radians(10.0), abs=2 * table.angle_error
    )


def test_commands_out_of_place_move_nobody(table: Table) -> None:
    table.begin(1)
    table.command(1, 5, hider="forward", seeker="forward")
    table.command(7, 0, hider="forward", seeker="forward")
    assert not table.run(lambda: any(pose.step > 0 for pose in table.messages("hider/pose", 1)), 1.5)
    assert table.messages("hider/pose", 7) == []
    table.move(1, 0, "left", "left")


@pytest.mark.parametrize("phase", ["ended", "aborted"])
def test_after_the_end_nobody_moves(table: Table, phase: str) -> None:
    table.begin(1)
    table.phase(1, phase)
    table.run(lambda: False, 0.1)
    table.command(1, 0, hider="left", seeker="left")
    assert not table.run(lambda: table.has_step(1, 1), 1.5)


def test_a_new_episode_begins_at_step_0_in_the_middle_of_the_last(table: Table) -> None:
    table.begin(1)
    table.command(1, 0, hider="left", seeker="left")
    table.phase(1, "aborted")
    table.begin(2)
    said = [sample.decode() for sample in table.said if sample.key.endswith("pose")]
    assert [(pose.episode, pose.step) for pose in said if pose.episode == 2] == [(2, 0), (2, 0)]
    assert all(pose.step <= 1 for pose in said if pose.episode == 1)
    assert table.messages("layout", 2)
    table.move(2, 0, "right", "right")


def test_who_comes_again_plays_the_next_episode(table: Table) -> None:
    table.begin(1)
    table.restart()
    table.run(lambda: False, 0.5)
    table.phase(1, "aborted")
    table.begin(2)
    table.move(2, 0, "left", "right")


def test_every_message_is_within_its_bounds_and_comes_from_who_may_publish_it(table: TableOnTest) -> None:
    """The network under test takes every message through the codec: one out of bounds raises when it is decoded."""
    table.begin(1)
    table.move(1, 0, "left", "left")
    poses = [message for sample in table.said if isinstance(message := sample.decode(), Pose)]
    assert len(poses) == 4
    assert all(-math.pi <= pose.heading <= math.pi and 0.0 < pose.x < 1.2 and 0.0 < pose.y < 1.2 for pose in poses)
    assert not any(runtime.health_report("ok").failed for runtime in table.runtimes)
