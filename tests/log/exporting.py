"""Real games to export: the real cores in one process, with a 160 x 120 camera, and what a planner adds."""

from __future__ import annotations

import atexit
import shutil
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from msgspec import structs

from learning.collect import CollectSettings, play_block
from schemas import GOAL_COUNT, STATE_IMAGE_SIZE, Control, Episode, Plan, Players, PredictReply, PredictRequest, encode
from services.simulator.core import SimulatorSettings
from tests.log.making import write_record
from vantage.log import LogWriter, Record, RunMetadata, read
from vantage.world.camera import Camera

PERSON = "Ada Lovelace"


@cache
def real_log(games: int = 3, steps: int = 12) -> Path:
    """The log of `make_log`, made once and removed at the end."""
    folder = Path(mkdtemp(prefix="vantage-export-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return make_log(folder, games, steps)


def make_log(folder: Path, games: int, steps: int) -> Path:
    """Make a log of real games with pictures, state images, plans with values, predictions and a person's name."""
    settings = CollectSettings(
        games=games,
        hider="goal-walk",
        to=folder,
        steps=steps,
        catching=False,
        world=SimulatorSettings(Camera(width=160, height=120)),
        views=True,
    )
    play_block(settings, range(1, games + 1), folder / "plain.mcap")
    records = [_enriched(record) for record in read(folder / "plain.mcap")]
    path = folder / "real.mcap"
    write(path, [record for some in records for record in some])
    return path


def write(path: Path, records: list[Record], chunk_size: int = 1 << 16) -> None:
    """Write records as a finished log."""
    with LogWriter(path, RunMetadata(commit="test"), sync=False, chunk_size=chunk_size) as log:
        for record in records:
            write_record(log, record)


def discard(number: int, after: Record) -> Record:
    """The wish that a game is not to be used."""
    wish = Control(stamp=after.log_time, action="discard", episode=number)
    return Record("control", "console", 0, after.log_time + 1, after.log_time, encode(wish))


def _enriched(record: Record) -> list[Record]:
    message = record.decode()
    if isinstance(message, Episode):
        message = structs.replace(message, players=Players(hider="human", person=PERSON))
        return [structs.replace(record, payload=encode(message))]
    if not isinstance(message, Plan):
        return [record]
    values = tuple(None if goal % 7 == 3 else 0.01 * goal for goal in range(GOAL_COUNT))
    common = {"stamp": message.stamp, "episode": message.episode, "step": message.step}
    paths = np.zeros((2, 11, 2), np.float32)
    request = PredictRequest(
        **common,
        state_image=bytes(STATE_IMAGE_SIZE**2),
        path_count=2,
        path_steps=11,
        paths=paths.tobytes(),
        horizons=(5, 10),
        views=((0, 0), (0, 1)),
    )
    view = bytes([40, 80, 120]) * STATE_IMAGE_SIZE**2
    reply = PredictReply(**common, caught=np.array([0.1, 0.2, 0.3, 0.4], np.float32).tobytes(), views=(view, view))
    return [
        Record(key, publisher, record.sequence, record.log_time, record.publish_time, encode(said))
        for key, publisher, said in (
            ("predictor/request", "predictor", request),
            ("predictor/reply", "predictor", reply),
            ("hider/plan", "hider", structs.replace(message, values=values, goal=5)),
        )
    ]
