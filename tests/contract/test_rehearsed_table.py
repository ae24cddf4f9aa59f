"""What a real table owes beyond the simulator: tracks at the camera's rate, layouts while it sets up, words for what is lost."""

from __future__ import annotations

import math

import numpy as np

from schemas import ROBOTS
from services.tracker.core import TrackerCore
from tests.contract.tables import RehearsedTable
from vantage.service import SECOND


def test_tracks_come_at_the_cameras_rate_and_are_where_the_robots_are(rehearsed: RehearsedTable) -> None:
    rehearsed.run(lambda: False, 2.0)
    for index, robot in enumerate(ROBOTS):
        tracks = rehearsed.messages(f"{robot}/track", 0)
        assert 30 <= len(tracks) <= 41
        truth = rehearsed.world.poses()[index]
        assert math.hypot(tracks[-1].x - truth[0], tracks[-1].y - truth[1]) < 0.003
        assert abs(math.remainder(tracks[-1].heading - truth[2], math.tau)) < 0.02


def test_the_layout_is_said_without_a_game_and_again_and_again_while_one_is_set_up(rehearsed: RehearsedTable) -> None:
    assert rehearsed.run(lambda: bool(rehearsed.messages("layout", 0)), 2.0)
    rehearsed.begin(1, seed=2)  # a start elsewhere: the robots drive there
    stamps = [message.stamp for message in rehearsed.messages("layout", 1)]
    assert len(stamps) >= 3
    assert max(np.diff(stamps)) < 3 * SECOND
    said = len(stamps)
    rehearsed.run(lambda: False, 2.5)
    assert len(rehearsed.messages("layout", 1)) == said


def test_the_tracked_boxes_are_the_true_ones(rehearsed: RehearsedTable) -> None:
    assert rehearsed.run(lambda: bool(rehearsed.messages("layout", 0)), 2.0)
    rehearsed.run(lambda: False, 2.0)
    boxes = rehearsed.messages("layout", 0)[-1].obstacles
    truth = rehearsed.calibrated.table.obstacles
    assert len(boxes) == len(truth)
    for box in boxes:
        true = min(rehearsed.obstacles, key=lambda other: math.hypot(other.x - box.x, other.y - box.y))
        assert math.hypot(true.x - box.x, true.y - box.y) < 0.004
        assert abs(math.remainder(true.heading - box.heading, math.tau)) < 0.03
        assert (box.half_width, box.half_depth, box.height) == (true.half_width, true.half_depth, true.height)


def tracker_trouble(table: RehearsedTable) -> str:
    """What it says of itself; that commands are old while a test takes its time is another matter."""
    core = table.runtimes[2].core
    assert isinstance(core, TrackerCore)
    return core.trouble


def test_a_camera_without_frames_is_named_and_the_game_goes_on_when_it_is_back(rehearsed: RehearsedTable) -> None:
    rehearsed.begin(1)
    for camera in ("hider camera", "seeker camera", "overhead camera"):
        assert camera not in tracker_trouble(rehearsed)
        rehearsed.unplug(camera)
        rehearsed.run(lambda: False, 1.4)
        assert f"{camera}: no frame for 1." in tracker_trouble(rehearsed)
        rehearsed.unplug()
        rehearsed.run(lambda: False, 0.6)
    assert tracker_trouble(rehearsed) == ""
    rehearsed.move(1, 0, "left", "left")


def test_a_step_waits_for_the_camera_that_is_missing(rehearsed: RehearsedTable) -> None:
    rehearsed.begin(1)
    rehearsed.unplug("seeker camera")
    rehearsed.command(1, 0, hider="left", seeker="left")
    assert not rehearsed.run(lambda: rehearsed.has_step(1, 1), 2.5)
    back = rehearsed.clock()
    rehearsed.unplug()
    assert rehearsed.run(lambda: rehearsed.has_step(1, 1), 1.0)
    assert rehearsed.step_of("seeker/depth", 1, 1).stamp > back
    assert rehearsed.step_of("hider/depth", 1, 1).stamp < back


def test_a_tracker_that_comes_again_in_mid_game_goes_on_with_the_step_that_is_due(rehearsed: RehearsedTable) -> None:
    rehearsed.begin(1)
    rehearsed.command(1, 0, hider="left", seeker="right")
    rehearsed.run(lambda: False, 0.05)
    rehearsed.restart()
    assert rehearsed.run(lambda: rehearsed.has_step(1, 1), 3.0), rehearsed.troubles()
    rehearsed.publish_tick(1, 1)
    rehearsed.move(1, 1, "right", "left")


def test_a_robot_that_cannot_be_driven_gives_no_step_and_the_reason(rehearsed: RehearsedTable) -> None:
    rehearsed.begin(1)
    rehearsed.unplug("seeker line")
    rehearsed.command(1, 0, hider="left", seeker="left")
    assert rehearsed.run(lambda: any(motion.step == 1 for motion in rehearsed.messages("seeker/motion", 1)), 6.0)
    rehearsed.run(lambda: False, 1.0)
    (motion,) = (message for message in rehearsed.messages("seeker/motion", 1) if message.step == 1)
    assert motion.result in ("stopped", "lost") and motion.reason
    assert not rehearsed.has_step(1, 1)
    assert f"no step 1: seeker {motion.result}: {motion.reason}" in tracker_trouble(rehearsed)
    assert "seeker" in rehearsed.runtimes[1].health_report("ok").reason
    rehearsed.phase(1, "aborted")
    rehearsed.unplug()
    rehearsed.begin(2)
    rehearsed.move(2, 0, "left", "left")
