"""A game as an MP4 that browsers play: H.264, at the speed at which it was played."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

from schemas import ROBOTS
from vantage.log.appearance import Appearance
from vantage.log.game_picture import HEIGHT, WIDTH, GamePicture
from vantage.log.outline import GameOutline, called, steps_of
from vantage.log.reader import Log
from vantage.log.target import ExportError, Progress, begins_with, in_silence, optional, whole

KEYS = (*(f"{robot}/{part}" for robot in ROBOTS for part in ("pose", "color", "view")), "hider/plan")
is_video = begins_with(b"ftyp", at=4)
TIME_BASE = Fraction(1, 1000)
LINGER = 2000
"""ms that the last picture stays."""
_FASTEST = 5_000_000
"""ns a step below which a log was not made in real time."""
_USUAL_PERIOD = 0.25


def write_video(
    log: Log, game: GameOutline, target: Path, looks: Appearance, *, force: bool = False, progress: Progress = in_silence
) -> str:
    """Write a game as a video, a picture a step, each at the moment of its capture. Returns what is in it, for people.

    A game that was not played in real time (`step_period` 0) gets 0.25 s a step.

    Raises:
        ExportError: a package is missing, or the target exists.
        OSError: the disk.
    """
    av = optional("av", "av")
    if "libx264" not in av.codecs_available:
        raise ExportError("the installed package av has no libx264, which writes what browsers play: pip install 'av>=14'")
    picture = GamePicture(game, looks)
    in_real_time = game.last_time - game.first_time >= _FASTEST * max(game.steps, 1)
    period = game.episode.rules.step_period or _USUAL_PERIOD
    with whole(target, force=force, is_ours=is_video) as partial:
        try:
            with av.open(str(partial), "w", format="mp4", options={"movflags": "+faststart"}) as container:
                count, last = _write(container, av, log, game, picture, None if in_real_time else period, progress)
        except av.error.FFmpegError as error:
            raise OSError(error.errno, error.strerror, str(target)) from error
        if count == 0:
            raise ExportError(f"game {game.number} has no step with a pose")
    speed = "" if in_real_time else f"; it was not played in real time, a step is shown for {period:g} s"
    return f"{called(game)}, {count} steps, {(last + LINGER) / 1000:.1f} s{speed}"


def _write(
    container: Any, av: Any, log: Log, game: GameOutline, picture: GamePicture, period: float | None, progress: Progress
) -> tuple[int, int]:
    """Encode all steps; return how many, and when the last begins, ms."""
    stream = container.add_stream("libx264", rate=30, options={"crf": "20", "preset": "veryfast", "bf": "0", "threads": "2"})
    stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
    stream.time_base = stream.codec_context.time_base = TIME_BASE
    stream.codec_context.gop_size = 8
    start, last, count, pixels = 0, -1, 0, None

    def encode(moment: int) -> None:
        frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
        frame.pts, frame.time_base = moment, TIME_BASE
        container.mux(stream.encode(frame))

    for _, step, messages in steps_of(log, [game], KEYS):
        pose = messages.get("hider/pose") or messages.get("seeker/pose")
        if pose is None:
            continue
        start = start or pose.stamp
        seconds = (pose.stamp - start) / 1e9 if period is None else step * period
        last = max(last + 1, round(seconds * 1000))
        pixels = picture.draw(step, seconds, messages)
        encode(last)
        count += 1
        progress("drawing", step / max(game.steps, 1))
    if count:
        # The last picture a second time, or it would be gone at once.
        encode(last + LINGER)
    container.mux(stream.encode())
    return count, last
