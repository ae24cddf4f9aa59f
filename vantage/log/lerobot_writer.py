"""A LeRobot v3 data set in the making: Parquet files with PNGs as steps come, and at the end what `meta/` says of them."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from schemas import (
    PRIMITIVES,
    ROBOTS,
    STATE_IMAGE_SIZE,
    ColorImage,
    Command,
    DepthImage,
    Message,
    Pose,
    Robot,
    StateImage,
)
from vantage.log import lerobot_features as form
from vantage.log.appearance import Appearance
from vantage.log.lerobot_statistics import Histogram, Statistics, Total, as_lists, of_rows
from vantage.log.outline import GameOutline
from vantage.log.target import ExportError, optional

_ROWS_AT_A_TIME = 64


class DatasetWriter:
    """Writes frames, a row group at a time; `close`, then `write_meta` end it."""

    def __init__(self, folder: Path, looks: Appearance, views: bool, choice: form.Choice) -> None:
        """Args:
        folder: new.
        views: whether all games have state images.
        choice: what comes in.

        Raises:
            ExportError: a package is missing.
        """
        self.views = views
        self.episodes = self.frames = 0
        self._arrow: Any = optional("pyarrow", "pyarrow")
        self._choice = choice
        self._robots = form.picture_robots(choice)
        self._uncatchable = 0
        self._parquet = optional("pyarrow.parquet", "pyarrow")
        self._image = optional("PIL.Image", "pillow")
        self._folder = folder
        self._palette = looks.palette
        self._sizes: dict[Robot, tuple[int, int]] = {}
        self._features: dict[str, form.Feature] = {}
        self._schema: Any = None
        self._file: Any = None
        self._file_number = 0
        self._rows: dict[str, list[Any]] = {}
        self._row_count = 0
        self._numbers: dict[str, list[Any]] = {}
        self._histograms: dict[str, Histogram] = {}
        self._total = Total()
        self._entries: list[dict[str, Any]] = []
        self._start = self._first_index = self._in_episode = 0
        self._last_stamp = 0
        self._spacings: list[float] = []

    def add(self, game: GameOutline, step: int, messages: dict[str, Message]) -> None:
        """Take a step of the game that is being written."""
        self._require_sizes(game, messages)
        stamp = messages["hider/color"].stamp
        if step == 0:
            self._start, self._first_index, self._in_episode = stamp, self.frames, 0
        elif len(self._spacings) < 100_000:
            self._spacings.append((stamp - self._last_stamp) / 1e9)
        self._last_stamp = stamp
        for robot in self._robots:
            color = cast(ColorImage, messages[f"{robot}/color"])
            pixels = np.frombuffer(color.data, np.uint8).reshape(color.height, color.width, 3)
            self._add_picture(form.picture_name(robot, "color"), pixels)
            if self.views:
                view = cast(StateImage, messages[f"{robot}/view"])
                indices = np.frombuffer(view.data, np.uint8).reshape(STATE_IMAGE_SIZE, STATE_IMAGE_SIZE)
                self._add_picture(form.picture_name(robot, "view"), np.take(self._palette, indices, axis=0, mode="clip"))
            depth = cast(DepthImage, messages[f"{robot}/depth"])
            distances = np.frombuffer(depth.data, "<u2").reshape(depth.height, depth.width)
            name = form.depth_name(robot)
            self._rows.setdefault(name, []).append(distances)
            self._histograms.setdefault(name, Histogram(1, 1 << 16, 1.0, (1, 1))).add(distances)
        done = step == game.steps - 1
        self._add_numbers("observation.state", _pose(messages["hider/pose"]))
        self._add_numbers("action", _action(game, "hider", step, messages))
        self._add_numbers("privileged.seeker_state", _pose(messages["seeker/pose"]))
        self._add_numbers("privileged.seeker_action", _action(game, "seeker", step, messages))
        self._add_numbers("next.done", done)
        self._add_numbers("next.success", done and game.episode.rules.catching and game.episode.outcome == "survived")
        self._add_numbers("capture_time_ns", stamp)
        self._add_numbers("timestamp", (stamp - self._start) / 1e9)
        self._add_numbers("frame_index", step)
        self._add_numbers("episode_index", self.episodes)
        self._add_numbers("index", self.frames)
        self._add_numbers("task_index", 0)
        self.frames += 1
        self._in_episode += 1
        self._row_count += 1
        if self._row_count >= _ROWS_AT_A_TIME:
            self._write_rows()

    def end_episode(self, game: GameOutline, log_name: str) -> None:
        """Note what was written as an episode."""
        self._write_rows()
        statistics: dict[str, Statistics] = {name: of_rows(np.array(rows)) for name, rows in self._numbers.items()}
        statistics |= {name: histogram.statistics() for name, histogram in self._histograms.items()}
        self._numbers, self._histograms = {}, {}
        self._total.add(statistics)
        said = game.episode
        boxes = (
            [{name: getattr(box, name) for name in box.__struct_fields__} for box in game.layout.obstacles] if game.layout else []
        )
        entry: dict[str, Any] = {
            "episode_index": self.episodes,
            "tasks": [form.TASK],
            "length": self._in_episode,
            "data/chunk_index": self._file_number // form.CHUNK_SIZE,
            "data/file_index": self._file_number % form.CHUNK_SIZE,
            "dataset_from_index": self._first_index,
            "dataset_to_index": self.frames,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
            # The person's name stays out: `players.person` is not copied.
            "vantage/game": said.episode,
            "vantage/seed": said.seed,
            "vantage/outcome": said.outcome,
            "vantage/catching": said.rules.catching,
            "vantage/hider": said.players.hider,
            "vantage/seeker": said.players.seeker,
            "vantage/obstacles": json.dumps(boxes),
            "vantage/log": log_name,
        }
        for name, found in statistics.items():
            entry |= {f"stats/{name}/{kind}": value for kind, value in as_lists(found).items()}
        self._entries.append(entry)
        self._uncatchable += not said.rules.catching
        self.episodes += 1
        if self._path().stat().st_size >= form.FILE_SIZE << 20:
            self.close()
            self._file_number += 1

    def close(self) -> None:
        """Finish the present data file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def write_meta(self) -> None:
        """Write `meta/` and the card."""
        meta = self._folder / "meta"
        meta.mkdir(parents=True, exist_ok=True)
        fps = max(1, round(1 / max(float(np.median(self._spacings)), 1e-3))) if self._spacings else 1
        info = form.info_of(self._features, fps, self.episodes, self.frames)
        (meta / "info.json").write_text(json.dumps(info, indent=4))
        (meta / "stats.json").write_text(json.dumps(self._total.as_lists(), indent=1))
        (self._folder / "README.md").write_text(form.card(fps, self._features, self._uncatchable))
        self._parquet.write_table(form.tasks_table(self._arrow), meta / "tasks.parquet")
        path = self._folder / form.EPISODES_PATH.format(chunk_index=0, file_index=0)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._parquet.write_table(self._arrow.Table.from_pylist(self._entries), path)

    def _path(self) -> Path:
        chunk, number = divmod(self._file_number, form.CHUNK_SIZE)
        return self._folder / form.DATA_PATH.format(chunk_index=chunk, file_index=number)

    def _require_sizes(self, game: GameOutline, messages: dict[str, Message]) -> None:
        for robot in ROBOTS:
            color, depth = cast(ColorImage, messages[f"{robot}/color"]), cast(DepthImage, messages[f"{robot}/depth"])
            size = self._sizes.setdefault(robot, (color.height, color.width))
            for picture in (color, depth):
                if (picture.height, picture.width) != size:
                    raise ExportError(
                        f"the pictures of game {game.number} are {picture.width} x {picture.height}, those before "
                        f"{size[1]} x {size[0]}: a data set has one size, so export the logs one by one"
                    )
        if not self._features:
            self._features = form.features_of(self._sizes, self.views, self._choice)
            self._schema = form.schema_of(self._arrow, self._features)

    def _add_numbers(self, name: str, value: Any) -> None:
        self._rows.setdefault(name, []).append(value)
        self._numbers.setdefault(name, []).append(value)

    def _add_picture(self, name: str, pixels: NDArray[np.uint8]) -> None:
        packed = io.BytesIO()
        self._image.fromarray(pixels).save(packed, "PNG", compress_level=2)
        self._rows.setdefault(name, []).append({"bytes": packed.getvalue(), "path": None})
        self._histograms.setdefault(name, Histogram(3, 256, 255.0, (3, 1, 1))).add(pixels)

    def _write_rows(self) -> None:
        if not self._row_count:
            return
        arrow = self._arrow
        columns = []
        for column in self._schema:
            rows = self._rows[column.name]
            if self._features[column.name]["dtype"] == "uint16":
                stack = np.stack(rows)  # [n, H, W]
                count, height, width = stack.shape
                lines = arrow.ListArray.from_arrays(
                    np.arange(count * height + 1, dtype=np.int32) * width, arrow.array(stack.ravel())
                )
                columns.append(arrow.ListArray.from_arrays(np.arange(count + 1, dtype=np.int32) * height, lines))
            else:
                columns.append(arrow.array(rows, column.type))
        if self._file is None:
            path = self._path()
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._parquet.ParquetWriter(path, self._schema, compression="zstd", use_dictionary=False)
        self._file.write_table(arrow.Table.from_arrays(columns, schema=self._schema))
        self._rows, self._row_count = {}, 0


def _pose(message: Message) -> NDArray[np.float32]:
    pose = cast(Pose, message)
    return np.array((pose.x, pose.y, pose.heading), np.float32)


def _action(game: GameOutline, robot: str, step: int, messages: dict[str, Message]) -> NDArray[np.float32]:
    """One-hot of what the robot did: its command, or `stay` where that came too late."""
    primitive = "stay"
    if not game.stayed(cast(Any, robot), step):
        primitive = cast(Command, messages[f"{robot}/command"]).primitive
    return np.eye(len(PRIMITIVES), dtype=np.float32)[PRIMITIVES.index(primitive)]
