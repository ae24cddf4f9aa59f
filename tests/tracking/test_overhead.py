from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import cv2
import numpy as np
import pytest

from schemas import Box
from tests.tracking.overhead_scene import FRAME, LAB, ROBOTS, START, Floats, Picture, Watch, copied, covered, picture, scene
from vantage.tracking.filter import TrackState
from vantage.tracking.overhead import Observation
from vantage.tracking.tag_mount import robot_mounts
from vantage.tracking.tag_pose import wrapped
from vantage.tracking.tags import TagFinder

SPEEDS = np.array([[0.10, 0.05, 1.0], [-0.05, 0.08, -2.0]])


def error_of(track: TrackState | None, truth: Floats) -> tuple[float, float]:
    """mm and degrees."""
    assert track is not None
    place = 1000 * math.hypot(track.x - truth[0], track.y - truth[1])
    return place, abs(math.degrees(wrapped(track.heading - truth[2])))


def assert_exact(observation: Observation, robots: Floats = ROBOTS) -> None:
    for index, robot in enumerate(("hider", "seeker")):
        track = observation.tracks[robot]
        assert track is not None and track.seen
        place, heading = error_of(track, robots[index])
        assert place < 1.0 and heading < 0.6


def test_everything_is_found_in_the_first_picture_and_boxes_in_the_third() -> None:
    watch, seen = Watch(), picture()
    first = watch.show(seen)
    assert first.full_search and first.troubles == ()
    assert_exact(first)
    third = watch.show(seen, 2)
    assert not third.full_search
    assert len(third.boxes) == 3
    for found, box in zip(third.boxes, LAB, strict=True):
        assert 1000 * math.hypot(found.x - box.x, found.y - box.y) < 0.5
        assert abs(math.degrees(wrapped(found.heading - box.heading))) < 0.5
        assert (found.half_width, found.half_depth, found.height) == (box.half_width, box.half_depth, box.height)


def test_moving_robots_are_followed_with_their_speeds() -> None:
    watch = Watch()
    for frame in range(30):
        robots = ROBOTS + SPEEDS * frame * FRAME * 1e-9
        observation = watch.show(picture(robots, frame=frame, speeds=SPEEDS))
        assert_exact(observation, robots)
        assert observation.troubles == ()
    for index, robot in enumerate(("hider", "seeker")):
        track = observation.tracks[robot]
        assert track is not None and track.stamp == START + 29 * FRAME
        assert (track.speed_x, track.speed_y) == pytest.approx(SPEEDS[index, :2], abs=0.02)
        assert track.turn_rate == pytest.approx(SPEEDS[index, 2], abs=0.25)


def test_windows_give_the_same_poses_as_searching_every_whole_frame() -> None:
    """Brute force: all tags of every whole frame, one pose each, no memory."""
    watch, finder = Watch(), TagFinder()
    for frame in range(12):
        robots = ROBOTS + SPEEDS * frame * FRAME * 1e-9
        seen = picture(robots, frame=frame, speeds=SPEEDS)
        observation = watch.show(seen)
        found = {tag.id: tag for tag in finder.find(seen, (0, 0, 1280, 720), half=False)}
        for robot, mount in robot_mounts(watch.tracker.table, watch.tracker.camera).items():
            pose = mount.measure(found[mount.tag], 0.15, 0.1, 0.01).pose
            place, heading = error_of(observation.tracks[robot], pose)
            assert place < 0.4 and heading < 0.5


def test_grey_pictures_do_as_well() -> None:
    assert_exact(Watch().show(cv2.cvtColor(picture(), cv2.COLOR_RGB2GRAY)))


def test_a_lost_tag_is_predicted_then_forgotten_told_and_found_again() -> None:
    watch, seen = Watch(), picture()
    watch.show(seen, 5)
    hidden = covered(seen, 0)
    observation = watch.show(hidden)
    track = observation.tracks["hider"]
    assert track is not None and not track.seen and error_of(track, ROBOTS[0])[0] < 2
    other = observation.tracks["seeker"]
    assert other is not None and other.seen
    assert watch.show(hidden, 11).tracks["hider"] is not None
    lost = watch.show(hidden, 6)
    assert lost.tracks["hider"] is None and lost.tracks["seeker"] is not None
    (trouble,) = lost.troubles
    assert trouble.startswith("hider's tag 0 not seen since ") and trouble.endswith("(covered, or no contrast)")
    assert watch.show(hidden, 30).troubles == (trouble,), "the text stays the same while the tag is gone"
    back = watch.show(seen, 12)
    assert_exact(back)
    assert back.troubles == ()


def test_a_robot_carried_elsewhere_is_found_there() -> None:
    watch = Watch()
    watch.show(picture(), 5)
    elsewhere = np.array([[0.9, 1.05, 2.0], ROBOTS[1]])
    assert_exact(watch.show(picture(elsewhere), 14), elsewhere)


def test_a_robot_that_was_never_there_is_told() -> None:
    watch, alone = Watch(), np.array([ROBOTS[0], [np.nan] * 3])
    observation = watch.show(picture(alone), 15)
    assert observation.tracks["seeker"] is None and observation.tracks["hider"] is not None
    assert any(trouble.startswith("seeker's tag 1 was never seen") for trouble in observation.troubles)


def test_searching_for_what_is_missing_is_throttled() -> None:
    watch, alone = Watch(), picture(np.array([ROBOTS[0], [np.nan] * 3]))
    searched = [watch.show(alone).full_search for _ in range(60)]
    assert 6 <= sum(searched) <= 9


def test_of_two_tags_of_one_id_the_one_at_the_predicted_place_is_used() -> None:
    watch, seen = Watch(), picture()
    watch.show(seen, 5)
    twins = copied(seen, 0, 800, 560)
    told = False
    for _ in range(75):
        observation = watch.show(twins)
        assert_exact(observation)
        told |= any(trouble.startswith("hider's tag 0 is seen twice, at (0.25, 0.30) and (") for trouble in observation.troubles)
    assert told
    assert watch.show(seen, 170).troubles == ()


def test_of_two_tags_of_one_id_neither_is_used_without_a_prediction() -> None:
    watch = Watch()
    observation = watch.show(copied(picture(), 0, 800, 560), 20)
    assert observation.tracks["hider"] is None
    assert any("hider's tag 0 is seen twice" in trouble for trouble in observation.troubles)
    assert_exact(watch.show(picture(), 12))


def test_two_tags_of_one_id_side_by_side() -> None:
    watch, seen = Watch(), picture()
    watch.show(seen, 5)
    corners = scene().true_corners(ROBOTS, LAB)[0].mean(axis=0)
    observation = watch.show(copied(seen, 0, int(corners[0]) + 34, int(corners[1]) - 27), 80)
    assert_exact(observation)
    assert any("hider's tag 0 is seen twice" in trouble for trouble in observation.troubles)


@pytest.mark.parametrize(
    ("size", "says"),
    [((640, 480), "640 x 480, the calibration is for 1280 x 720"), ((1920, 1080), "1920 x 1080")],
)
def test_another_resolution_is_a_trouble_not_a_crash(size: tuple[int, int], says: str) -> None:
    watch = Watch()
    watch.show(picture(), 3)
    observation = watch.show(cv2.resize(picture(), size))
    (trouble,) = observation.troubles
    assert says in trouble
    track = observation.tracks["hider"]
    assert track is not None and not track.seen
    assert_exact(watch.show(picture()))
    assert watch.show(np.zeros(5, np.uint8)).troubles[0].startswith("overhead picture is of 1 dimensions")


def darkened(seen: Picture) -> Picture:
    return (seen * 0.08).astype(np.uint8)


def overexposed(seen: Picture) -> Picture:
    return np.clip(seen.astype(np.int32) * 3, 0, 255).astype(np.uint8)


def glaring(seen: Picture) -> Picture:
    column, row = scene().true_corners(ROBOTS, LAB)[0].mean(axis=0).astype(int)
    return np.asarray(cv2.circle(seen.copy(), (int(column), int(row)), 30, (255, 255, 255), -1))


def blurred(seen: Picture) -> Picture:
    return np.asarray(cv2.GaussianBlur(seen, (0, 0), 5.0))


@pytest.mark.parametrize(
    ("spoil", "says"),
    [(darkened, "too dark"), (overexposed, "overexposed"), (glaring, "glare"), (blurred, "blurred")],
)
def test_bad_pictures_are_told_by_their_cause(spoil: Callable[[Picture], Picture], says: str) -> None:
    watch, seen = Watch(), picture()
    watch.show(seen, 3)
    observation = watch.show(spoil(seen), 20)
    assert any(says in trouble for trouble in observation.troubles), observation.troubles
    recovered = watch.show(seen, 25)
    assert_exact(recovered)
    assert recovered.troubles == ()


def test_a_moved_box_is_moved_once_and_a_trembling_one_not() -> None:
    watch = Watch()
    still = watch.show(picture(), 10).boxes
    first = LAB[0]
    nudged = (Box(x=first.x + 0.0015, y=first.y, half_width=0.12, half_depth=0.06, heading=first.heading), *LAB[1:])
    assert watch.show(picture(boxes=nudged), 40).boxes == still
    moved = (Box(x=first.x + 0.03, y=first.y - 0.02, half_width=0.12, half_depth=0.06, heading=first.heading + 0.2), *LAB[1:])
    shown = picture(boxes=moved)
    layouts = [watch.show(shown).boxes for _ in range(150)]
    assert layouts[-1] != still
    changes = sum(before != after for before, after in pairwise(layouts)) + (layouts[0] != still)
    assert changes == 1
    assert layouts[-1][0].x == pytest.approx(moved[0].x, abs=5e-4) and layouts[-1][0].y == pytest.approx(moved[0].y, abs=5e-4)
    assert layouts[-1][1:] == still[1:]


def test_a_box_taken_away_is_told_and_then_left_out() -> None:
    watch = Watch()
    watch.show(picture(), 10)
    gone = picture(boxes=LAB[:2])
    assert len(watch.show(gone, 100).boxes) == 3
    told = watch.show(gone, 60)
    assert any(trouble.startswith("box tag 12 not seen since") for trouble in told.troubles)
    assert [box.half_depth for box in watch.show(gone, 200).boxes] == [0.06, 0.115]


def test_a_camera_that_was_knocked_is_told() -> None:
    watch, seen = Watch(), picture()
    assert watch.show(seen, 100).troubles == ()
    shifted = np.roll(seen, 8, axis=1)
    observation = watch.show(shifted, 60)
    assert sum("camera or tag moved, calibrate again" in trouble for trouble in observation.troubles) == 4


def test_a_lifted_robot_is_not_believed() -> None:
    watch, seen = Watch(), picture()
    watch.show(seen, 3)
    corners = scene().true_corners(ROBOTS, LAB)[0]
    low, high = corners.min(axis=0).astype(int) - 12, corners.max(axis=0).astype(int) + 12
    patch = cv2.resize(seen[low[1] : high[1], low[0] : high[0]], None, fx=1.15, fy=1.15, interpolation=cv2.INTER_CUBIC)
    lifted = seen.copy()
    lifted[low[1] : low[1] + patch.shape[0], low[0] : low[0] + patch.shape[1]] = patch
    observation = watch.show(lifted, 20)
    assert observation.tracks["hider"] is None
    assert any(trouble.startswith("hider's tag 0 looks 15 % too large") for trouble in observation.troubles)


def test_a_clock_that_jumps_backwards_or_far_ahead_is_survived() -> None:
    watch, seen = Watch(), picture()
    watch.show(seen, 5)
    watch.stamp = START - 3600 * 10**9
    assert_exact(watch.show(seen, 12))
    watch.stamp = START + 3600 * 10**9
    observation = watch.show(seen, 12)
    assert_exact(observation)
    assert len(observation.boxes) == 3 and observation.troubles == ()


def test_of_two_tags_of_one_box_the_one_where_it_stood_is_used_and_both_are_told() -> None:
    watch, seen = Watch(), picture()
    still = watch.show(seen, 10).boxes
    twins, told = copied(seen, 10, 800, 560), False
    for _ in range(150):
        observation = watch.show(twins)
        assert observation.boxes == still
        told |= any("box tag 10 is seen twice, at (" in trouble for trouble in observation.troubles)
    assert told
