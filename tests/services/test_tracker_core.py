"""The tracker's core, shown rendered pictures: its layouts, the steps it captures, what it says of clocks and cameras."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
import pytest

from schemas import ROBOTS, Box, ColorImage, DepthImage, Episode, Intrinsics, Layout, Message, Motion, Pose, Tick, Track
from services.tracker.core import CALIBRATION, OVERHEAD, RESUMING, Calibrated, TrackerCore
from tests.tracking.overhead_scene import START, calibration, covered, picture
from vantage.service import SECOND, Arrived, Captured, Publish, Send, Woken
from vantage.tracking.rgbd import default_rgbd
from vantage.tracking.table import default_table
from vantage.world.layout import LAB

FRAME = SECOND // 10
CALIBRATED = Calibrated(default_table(), calibration(), {robot: default_rgbd() for robot in ROBOTS})
FIRST, SECOND_TAG, THIRD = (tag.id for tag in default_table().obstacles)


class Shown:
    """A tracker with a clock: pictures and messages in, what it says out."""

    def __init__(self) -> None:
        self.core, self.now = TrackerCore(CALIBRATED), START
        self.said: list[tuple[str, Any]] = []

    def _keep(self, sends: Sequence[Send]) -> None:
        self.said += [(send.key, send.message) for send in sends if isinstance(send, Publish)]

    def wait(self, nanoseconds: int) -> None:
        end = self.now + nanoseconds
        while (wake := self.core.wake_at()) is not None and wake <= end:
            self.now = max(self.now, wake)
            self._keep(self.core.step(Woken(), self.now))
        self.now = end

    def show(self, seen: Any, times: int = 1, period: int = FRAME) -> None:
        for _ in range(times):
            self.wait(period)
            self._keep(self.core.step(Captured(OVERHEAD, seen, self.now), self.now))

    def frames(self, **shapes: tuple[int, int]) -> None:
        """A frame of each robot's camera, of 480 x 640 pixels unless told otherwise."""
        for robot in ROBOTS:
            shape = shapes.get(robot, (480, 640))
            value = (np.full(shape, 500, np.uint16), np.zeros((*shape, 3), np.uint8))
            self._keep(self.core.step(Captured(f"{robot} camera", value, self.now), self.now))

    def hear(self, key: str, message: Message) -> None:
        self._keep(self.core.step(Arrived(key, message), self.now))

    def phase(self, number: int, phase: Any) -> None:
        self.hear("episode", Episode(stamp=self.now, episode=number, seed=1, phase=phase))

    def rest(self, number: int, step: int, age: int = 0) -> None:
        """Both robots came to rest so long ago by the driver's clock."""
        for robot in ROBOTS:
            motion = Motion(stamp=self.now - age, episode=number, step=step, primitive="stay", result="completed")
            self.hear(f"{robot}/motion", motion)

    def look(self) -> None:
        """A frame of every camera."""
        self.show(picture())
        self.frames()

    def trouble(self) -> str:
        self.wait(SECOND // 2)
        return self.core.trouble

    @property
    def layouts(self) -> list[Layout]:
        return [message for _, message in self.said if isinstance(message, Layout)]

    def poses(self) -> list[tuple[int, int]]:
        return [(message.episode, message.step) for _, message in self.said if isinstance(message, Pose)]


@pytest.fixture
def shown() -> Shown:
    return Shown()


def moved(by: float) -> tuple[Box, ...]:
    first = LAB[0]
    return (
        Box(
            x=first.x + by,
            y=first.y,
            half_width=first.half_width,
            half_depth=first.half_depth,
            height=first.height,
            heading=first.heading,
        ),
        *LAB[1:],
    )


@pytest.mark.parametrize("stall", [FRAME, SECOND * 3 // 2, 12 * SECOND])
def test_the_first_layout_has_all_boxes_however_the_camera_stalls(shown: Shown, stall: int) -> None:
    shown.phase(1, "setup")
    shown.show(picture())
    shown.wait(stall)
    shown.show(picture(), 30)
    assert shown.layouts
    assert all(len(layout.obstacles) == 3 for layout in shown.layouts)


def test_a_box_that_the_first_picture_does_not_show_is_waited_for(shown: Shown) -> None:
    shown.show(covered(picture(), FIRST))
    shown.show(picture(), 60)
    assert [len(layout.obstacles) for layout in shown.layouts] == [3]


def test_a_box_that_is_not_there_does_not_hold_the_layout_up_for_ever(shown: Shown) -> None:
    shown.show(picture(boxes=LAB[:2]), 60)
    assert [len(layout.obstacles) for layout in shown.layouts] == [2]


def test_no_layout_comes_of_pictures_in_the_dark(shown: Shown) -> None:
    shown.show(np.full_like(picture(), 10), 60)
    assert shown.layouts == []
    assert "too dark" in shown.trouble()


def test_a_camera_that_was_away_for_long_has_not_lost_the_boxes(shown: Shown) -> None:
    shown.show(picture(), 10)
    shown.wait(20 * SECOND)
    shown.show(picture(), 30)
    assert all(len(layout.obstacles) == 3 for layout in shown.layouts)


def test_after_a_calibration_in_mid_game_no_layout_is_said_before_its_boxes_are_known(shown: Shown) -> None:
    shown.phase(1, "setup")
    shown.show(picture(), 10)
    said = len(shown.layouts)
    shown.core.step(Captured(CALIBRATION, CALIBRATED, shown.now), shown.now)
    shown.show(picture())
    shown.wait(3 * SECOND)
    shown.show(picture(), 30)
    assert len(shown.layouts) > said
    assert all(len(layout.obstacles) == 3 for layout in shown.layouts)


def test_a_calibration_made_in_mid_game_counts(shown: Shown) -> None:
    shown.phase(1, "setup")
    shown.show(picture(), 10)
    before = shown.layouts[-1].obstacles
    tags = CALIBRATED.table.obstacles
    table = msgspec.structs.replace(CALIBRATED.table, obstacles=(msgspec.structs.replace(tags[0], along=0.02), *tags[1:]))
    shown.core.step(Captured(CALIBRATION, CALIBRATED._replace(table=table), shown.now), shown.now)
    shown.show(picture(), 10)
    after = shown.layouts[-1].obstacles
    assert math.hypot(after[0].x - before[0].x, after[0].y - before[0].y) == pytest.approx(0.02, abs=1e-3)
    assert "was moved" not in shown.trouble()


def test_a_box_whose_tag_is_hidden_stays_in_the_layout_of_the_game_and_leaves_it_after(shown: Shown) -> None:
    shown.phase(1, "setup")
    shown.show(picture(), 10)
    shown.show(covered(picture(), FIRST), 125)
    assert {layout.obstacles for layout in shown.layouts} == {shown.layouts[0].obstacles}
    assert len(shown.layouts[0].obstacles) == 3
    assert f"box tag {FIRST} not seen since" in shown.trouble()
    shown.phase(1, "ended")
    shown.show(covered(picture(), FIRST), 2)
    assert len(shown.layouts[-1].obstacles) == 2


def test_a_box_moved_during_a_game_is_said_and_the_layout_kept_until_the_next(shown: Shown) -> None:
    shown.phase(1, "setup")
    shown.show(picture(), 10)
    shown.show(picture(boxes=moved(0.05)), 50)
    assert len({layout.obstacles for layout in shown.layouts}) == 1
    assert f"box {FIRST} was moved during the game" in shown.trouble()
    assert f"box {SECOND_TAG}" not in shown.core.trouble and f"box {THIRD}" not in shown.core.trouble
    shown.phase(1, "ended")
    shown.show(picture(boxes=moved(0.05)))
    shown.phase(2, "setup")
    assert shown.layouts[-1].episode == 2
    assert shown.layouts[-1].obstacles[0].x == pytest.approx(LAB[0].x + 0.05, abs=1e-3)
    assert "was moved" not in shown.trouble()


def test_between_games_a_moved_box_is_news(shown: Shown) -> None:
    shown.show(picture(), 10)
    shown.show(picture(boxes=moved(0.05)), 50)
    assert shown.layouts[-1].obstacles[0].x == pytest.approx(LAB[0].x + 0.05, abs=1e-3)
    assert shown.trouble() == "hider camera: no frame yet; seeker camera: no frame yet"


@pytest.mark.parametrize("tick_first", [True, False])
def test_a_step_that_is_out_is_not_captured_again_by_a_tracker_that_was_restarted(shown: Shown, tick_first: bool) -> None:
    """As the network hands it over: the last motion, episode and tick, in any order."""
    heard = [
        lambda: shown.rest(1, 4, age=2 * SECOND),
        lambda: shown.phase(1, "running"),
        lambda: shown.hear("tick", Tick(stamp=shown.now, episode=1, step=4)),
    ]
    for hear in reversed(heard) if tick_first else heard:
        hear()
        shown.look()
    for _ in range(5):
        shown.look()
    assert shown.poses() == []
    shown.rest(1, 5)
    shown.look()
    assert shown.poses() == [(1, 5), (1, 5)]


def test_a_tick_that_comes_late_ends_the_capture_of_a_step_that_is_out(shown: Shown) -> None:
    shown.phase(1, "running")
    shown.rest(1, 4, age=2 * SECOND)
    shown.wait(RESUMING)
    shown.hear("tick", Tick(stamp=shown.now, episode=1, step=4))
    shown.look()
    assert shown.poses() == []


@pytest.mark.parametrize("ticked", [3, None])
def test_a_step_that_is_not_out_is_captured_by_a_tracker_that_was_restarted(shown: Shown, ticked: int | None) -> None:
    shown.phase(1, "running")
    if ticked is not None:
        shown.hear("tick", Tick(stamp=shown.now, episode=1, step=ticked))
    shown.hear("tick", Tick(stamp=shown.now, episode=9, step=99))
    if ticked is not None:
        shown.hear("tick", Tick(stamp=shown.now, episode=1, step=ticked))
    shown.rest(1, 4, age=2 * SECOND)
    shown.look()
    assert shown.poses() == []
    shown.wait(RESUMING)
    shown.look()
    assert shown.poses() == [(1, 4), (1, 4)]
    assert "clock" not in shown.trouble()


@pytest.mark.parametrize("clock", [-3600 * SECOND, -2 * SECOND, 0, 7 * SECOND])
def test_whatever_time_it_is_at_the_driver_a_step_is_what_was_captured_after_it(shown: Shown, clock: int) -> None:
    shown.phase(1, "setup")
    for step in range(3):
        shown.look()
        shown.rest(1, step, -clock)
        assert len(shown.poses()) == 2 * step  # what was captured before the report may be of a robot that still moved
        shown.look()
        assert shown.poses()[-2:] == [(1, step)] * 2
        assert "clock" not in shown.trouble()


@pytest.mark.parametrize("clock", [-3600 * SECOND, 0, 7 * SECOND])
def test_a_frame_captured_before_its_report_came_counts_where_the_report_is_known_to_be_late(shown: Shown, clock: int) -> None:
    shown.phase(1, "setup")
    shown.rest(1, 0, -clock)
    shown.look()
    assert shown.poses() == [(1, 0)] * 2
    shown.rest(1, 1, -clock)
    shown.wait(SECOND // 2)
    shown.look()
    shown.wait(SECOND // 5)
    shown.rest(1, 2, 4 * SECOND // 10 - clock)
    assert shown.poses()[-2:] == [(1, 2)] * 2


@pytest.mark.parametrize("clock", [-3600 * SECOND, 0, 7 * SECOND])
def test_pictures_of_a_camera_on_another_machine_are_stamped_with_the_own_time(shown: Shown, clock: int) -> None:
    shown.phase(1, "setup")
    for index in range(5):
        shown.wait(FRAME)
        seen = picture()
        height, width = seen.shape[:2]
        lens = Intrinsics(fx=1.0, fy=1.0, cx=1.0, cy=1.0)
        taken = shown.now - SECOND // 25
        image = ColorImage(stamp=taken + clock, width=width, height=height, intrinsics=lens, data=seen.tobytes())
        for published in (taken + SECOND // 30 + clock,) * 2:  # the second is not a new one
            shown._keep(shown.core.step(Arrived("overhead/color", image, published), shown.now))
        tracks = [message for _, message in shown.said if isinstance(message, Track)]
        assert len(tracks) == 2 * index  # the first picture may be an old one
        assert all(abs(track.stamp - taken) < SECOND // 50 for track in tracks[-2:])


def test_time_in_which_the_tracker_did_not_run_is_no_silence_of_the_cameras(shown: Shown) -> None:
    shown.phase(1, "setup")
    shown.look()
    shown.look()
    shown.now += 4 * SECOND
    shown.core.held_up(4 * SECOND, shown.now)
    shown.core.step(Woken(), shown.now)
    assert shown.core.trouble == ""
    assert "no frame for" in (shown.wait(4 * SECOND), shown.core.trouble)[1]


def test_pictures_of_another_size_are_a_trouble_and_no_crash(shown: Shown) -> None:
    shown.look()
    shown.frames(hider=(240, 320))
    said = shown.trouble()
    assert said.startswith("hider camera: the depth picture must be uint16 [480, 640]")
    shown.phase(1, "setup")
    shown.rest(1, 0)
    shown.show(picture())
    shown.frames(hider=(240, 320))
    assert shown.poses() == []
    assert "the depth picture must be" in shown.trouble()
    shown.look()
    assert shown.poses() == [(1, 0), (1, 0)]
    assert shown.trouble() == ""


def test_what_was_captured_before_the_later_of_both_motions_ended_does_not_count(shown: Shown) -> None:
    """The other robot still moved, and is in the pictures, too."""
    shown.phase(1, "setup")
    for robot, age in (("hider", 4 * SECOND // 10), ("seeker", 0)):
        shown.look()
        shown.wait(SECOND // 5)
        motion = Motion(stamp=shown.now - age, episode=1, step=0, primitive="stay", result="completed")
        shown.hear(f"{robot}/motion", motion)
    assert shown.poses() == []
    shown.look()
    assert shown.poses() == [(1, 0), (1, 0)]


def test_each_robots_pictures_are_made_of_its_own_camera_by_its_own_calibration(shown: Shown) -> None:
    level = msgspec.structs.replace(default_rgbd(), tilt=0.0)
    finer = msgspec.structs.replace(level, depth_unit=0.0005)
    shown.core = TrackerCore(CALIBRATED._replace(robots={"hider": level, "seeker": finer}))
    shown.phase(1, "setup")
    shown.rest(1, 0)
    shown.show(picture())
    for robot, counts in (("hider", 400), ("seeker", 1200)):
        value = (np.full((480, 640), counts, np.uint16), np.zeros((480, 640, 3), np.uint8))
        shown._keep(shown.core.step(Captured(f"{robot} camera", value, shown.now), shown.now))
    depths = {key: np.frombuffer(m.data, "<u2").max() for key, m in shown.said if isinstance(m, DepthImage)}
    assert depths == {"hider/depth": 400, "seeker/depth": 600}


def test_no_layout_is_said_while_the_overhead_camera_gives_no_frames(shown: Shown) -> None:
    """It would renew the referee's patience, and be of a table that nobody looks at."""
    shown.phase(1, "setup")
    shown.show(picture(), 10)
    shown.wait(3 * SECOND)
    said = len(shown.layouts)
    assert said > 0
    shown.wait(10 * SECOND)
    assert len(shown.layouts) == said
    shown.show(picture(), 30)
    assert len(shown.layouts) > said
