"""A game as a Rerun recording (.rrd), with the view it is looked at in.

Streamed: Rerun writes batches while the log is read. Timelines: `step`, `recorded` (log time) and `captured`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any

import numpy as np

from schemas import (
    MalformedMessage,
)
from vantage.log.appearance import Appearance
from vantage.log.outline import GameOutline, called
from vantage.log.reader import Log
from vantage.log.rerun_messages import Shown, view_of
from vantage.log.target import Progress, begins_with, in_silence, optional, whole

APPLICATION = "vantage"
is_recording = begins_with(b"RRF")
_CHUNK = 1 << 20


def write_recording(
    log: Log, game: GameOutline, target: Path, looks: Appearance, *, force: bool = False, progress: Progress = in_silence
) -> str:
    """Write a game as a Rerun recording. Returns what is in it, for people.

    Raises:
        ExportError: rerun-sdk is not installed, or the target exists.
        OSError: the disk.
    """
    rerun, blueprint = optional("rerun", "rerun-sdk"), optional("rerun.blueprint", "rerun-sdk")
    first, last = game.first_time, game.last_time
    count = 0
    with whole(target, force=force, is_ours=is_recording) as partial:
        recording = rerun.RecordingStream(APPLICATION, recording_id=f"{first}-game-{game.number}")
        with _saved(recording, partial):
            recording.send_recording_name(f"{called(game)}, seed {game.episode.seed}, {game.episode.outcome}")
            recording.set_log_time_enabled(False)
            recording.set_log_tick_enabled(False)
            shown = Shown(rerun, recording, looks)
            shown.begin()
            for record in log.records(after=first - 1):
                if record.log_time > last:
                    break
                try:
                    message = record.decode()
                except MalformedMessage:
                    continue
                if message.episode not in (0, game.number):
                    continue
                count += 1
                if count % 64 == 0:
                    progress("writing", (record.log_time - first) / max(last - first, 1))
                recording.set_time("recorded", timestamp=np.datetime64(record.log_time, "ns"))
                recording.set_time("captured", timestamp=np.datetime64(message.stamp, "ns"))
                if message.episode:
                    recording.set_time("step", sequence=message.step)
                else:
                    recording.disable_timeline("step")
                shown.show(record.key, message)
            recording.send_blueprint(view_of(blueprint, shown.entities))
    progress("writing", 1.0)
    return f"{called(game)}, {game.steps} steps; open it with `rerun {target.name}`"


@contextmanager
def _saved(recording: Any, target: Path) -> Iterator[None]:
    """Let a recording be written to a file, through a pipe; it is whole when the block has ended.

    Rerun's own thread dies on a full disk, and flushing may then wait for it for ever. So it gets a pipe, which is never full
    for long, and what comes out of it is written here.

    Raises:
        OSError: the disk.
    """
    errors: list[OSError] = []

    def write(descriptor: int) -> None:
        with open(descriptor, "rb", buffering=0) as pipe:
            try:
                with target.open("wb") as file:
                    while data := pipe.read(_CHUNK):
                        file.write(data)
            except OSError as error:
                errors.append(error)
                while pipe.read(_CHUNK):
                    pass

    with TemporaryDirectory(prefix="vantage-rerun-") as folder:
        pipe = Path(folder) / "pipe"
        os.mkfifo(pipe)
        descriptor = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)  # else it would wait for Rerun, which waits for it
        recording.save(pipe)
        os.set_blocking(descriptor, True)
        writer = Thread(target=write, args=(descriptor,), name="recording")
        writer.start()
        try:
            yield
            recording.flush()
        finally:
            recording.disconnect()
            writer.join()
    if errors:
        raise errors[0]
