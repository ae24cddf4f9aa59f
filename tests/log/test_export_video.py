"""The video, decoded again: what browsers need, one picture a step, at the times of the log."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
from msgspec import structs

from schemas import Message, StateImage
from services.recorder.appearance import arena_appearance
from tests.log.exporting import real_log, write
from tests.log.making import game, records_of
from vantage.log import open_log
from vantage.log.episodes import games_of
from vantage.log.export_formats import export_to
from vantage.log.game_picture import GamePicture
from vantage.log.outline import outline
from vantage.perception.palette import OTHER, OWN
from vantage.world.arena import HIDER_COLOR, SEEKER_COLOR

LOOKS = arena_appearance()


def decoded(path: Path) -> list[tuple[float, np.ndarray]]:
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height) == (1280, 720)
        return [(float(frame.pts * frame.time_base), frame.to_ndarray(format="rgb24")) for frame in container.decode(stream)]


def test_a_picture_a_step_at_its_time_and_the_robots_where_they_were(tmp_path: Path) -> None:
    export_to("video", real_log(), tmp_path / "two.mp4", LOOKS, episode=2)
    frames = decoded(tmp_path / "two.mp4")
    with open_log(real_log()) as log:
        played = next(found for found in games_of(log) if found.number == 2)
    assert len(frames) == played.steps + 2  # the last one stands a while
    start = played.poses["hider"][0].stamp
    for step in range(1, played.steps + 1):
        assert frames[step][0] == pytest.approx((played.poses["hider"][step].stamp - start) / 1e9, abs=0.002)
    assert frames[-1][0] == pytest.approx(frames[-2][0] + 2.0, abs=0.002)
    for step, (_, picture) in enumerate(frames[:-1]):
        for robot, color in (("hider", HIDER_COLOR), ("seeker", SEEKER_COLOR)):
            pose = played.poses[robot][step]  # type: ignore[index]
            # A point of the disc behind the centre, where no heading is drawn.
            x = 20 + 610 * (pose.x - 0.03 * np.cos(pose.heading)) / 1.2
            y = 80 + 610 * (1.2 - pose.y + 0.03 * np.sin(pose.heading)) / 1.2
            assert np.abs(picture[round(y), round(x)].astype(int) - color).max() < 40
    assert (tmp_path / "two.mp4").read_bytes().find(b"moov") < (tmp_path / "two.mp4").read_bytes().find(b"mdat")


def test_in_state_images_each_robot_has_its_own_colour_whoever_looks() -> None:
    """A pixel's index is drawn alike in every picture: nothing is green for the hider above and for the seeker below."""
    with open_log(real_log()) as log:
        played = next(found for found in outline(log) if found.number == 2)
    looks = {"hider": HIDER_COLOR, "seeker": SEEKER_COLOR}
    for column, (robot, other) in enumerate((("hider", "seeker"), ("seeker", "hider"))):
        for index, expected in ((OWN, robot), (OTHER, other)):
            view = StateImage(stamp=1, data=bytes([index]) * 128 * 128)
            drawn = GamePicture(played, LOOKS).draw(0, 0.0, {f"{robot}/view": view})
            assert tuple(drawn[356 + 96, 655 + column * 203 + 96]) == looks[expected], (robot, index)


def test_a_game_that_was_not_played_in_real_time_is_shown_at_the_usual_pace(tmp_path: Path) -> None:
    def at_once(message: Message) -> Message:
        return structs.replace(message, stamp=1_700_000_000_000_000_000 + message.step)

    messages = [(key, at_once(message)) for key, message in game(1, 6)]
    write(tmp_path / "log.mcap", records_of(messages, period=100))
    done = export_to("video", tmp_path / "log.mcap", None, LOOKS)
    assert "not played in real time" in done.said[0]
    assert [moment for moment, _ in decoded(tmp_path / "log.mp4")][:7] == pytest.approx([0.25 * step for step in range(7)])


def test_an_aborted_game_without_pictures_is_a_video_too(tmp_path: Path) -> None:
    messages = [(key, message) for key, message in game(1, 4, phase="aborted") if not key.endswith(("color", "depth"))]
    write(tmp_path / "log.mcap", records_of(messages, period=20_000_000))
    export_to("video", tmp_path / "log.mcap", tmp_path / "out.mp4", LOOKS)
    assert len(decoded(tmp_path / "out.mp4")) == 6
