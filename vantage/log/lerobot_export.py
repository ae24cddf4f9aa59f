"""Logs as a LeRobot v3 data set, written directly: Parquet files with PNGs, a game an episode.

Two passes over each log: the first says which games are whole, so that nothing has to be taken back; the second writes their
steps as they come. The folder gets its name when everything is in it.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
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
    StateImage,
)
from vantage.log import lerobot_features as form
from vantage.log.appearance import Appearance
from vantage.log.games import GameOutline, outline, steps_of
from vantage.log.lerobot_statistics import Histogram, Statistics, Total, as_lists, of_rows
from vantage.log.reader import Log, open_log
from vantage.log.target import ExportError, Progress, in_silence, optional, whole

_ROWS_AT_A_TIME = 64
_KEYS = tuple(f"{robot}/{part}" for robot in ROBOTS for part in ("pose", "depth", "color", "command"))
_VIEWS = tuple(f"{robot}/view" for robot in ROBOTS)


@dataclass
class DatasetSummary:
    """What became of the logs.

    Attributes:
        episodes, frames: written.
        left_out: a line for each reason why games were left out.
        breaks: what could not be read.
    """

    episodes: int = 0
    frames: int = 0
    left_out: list[str] = field(default_factory=list)
    breaks: list[str] = field(default_factory=list)


def write_dataset(
    logs: Sequence[Sequence[Path]],
    target: Path,
    looks: Appearance,
    *,
    episode: int | None = None,
    force: bool = False,
    progress: Progress = in_silence,
) -> DatasetSummary:
    """Write the finished games of logs as a LeRobot data set.

    Args:
        logs: each as its parts.
        target: the new folder.
        episode: only the game of this number.

    Raises:
        ExportError: nothing to write, or pictures of several sizes; the text says what to do.
        OSError: the disk.
    """
    arrow = optional("pyarrow", "pyarrow")
    optional("PIL.Image", "pillow")
    summary = DatasetSummary()
    chosen: list[tuple[Sequence[Path], list[GameOutline]]] = []
    reasons: dict[str, list[str]] = {}
    with whole(target, force=force, is_ours=is_dataset) as folder:
        for number, parts in enumerate(logs):
            with open_log(*parts) as log:
                games = outline(log, _part_of(progress, number, 2 * len(logs)))
                summary.breaks += log.breaks
            good = []
            for game in games:
                if episode is not None and game.number != episode:
                    continue
                reason = why_left_out(game)
                if reason:
                    reasons.setdefault(reason, []).append(
                        f"{game.number}" if len(logs) == 1 else f"{parts[0].stem}:{game.number}"
                    )
                else:
                    good.append(game)
            chosen.append((parts, good))
        summary.left_out = [_line(reason, games) for reason, games in reasons.items()]
        if not any(good for _, good in chosen):
            raise ExportError("; ".join(["no finished game to export", *summary.left_out]))
        views = all(game.has(key, game.steps) for _, good in chosen for game in good for key in _VIEWS)
        if not views:
            summary.left_out.append("left out: state images, which not all games have")
        writer = _Writer(arrow, folder, looks, views)
        try:
            for number, (parts, good) in enumerate(chosen):
                with open_log(*parts) as log:
                    _write_games(log, parts, good, writer, _part_of(progress, len(logs) + number, 2 * len(logs)))
        finally:
            writer.close()
        writer.write_meta()
    summary.episodes, summary.frames = writer.episodes, writer.frames
    return summary


def why_left_out(game: GameOutline) -> str:
    """Return why a game is not in a data set; empty when it is."""
    if game.discarded:
        return "taken back"
    if game.episode.phase == "aborted":
        return "aborted"
    if game.episode.phase != "ended":
        return "not finished in this log"
    if not game.complete:
        return "incomplete in this log"
    if game.steps == 0:
        return "over before the first step"
    for robot in ROBOTS:
        if not all(game.has_step(f"{robot}/command", step) or game.stayed(robot, step) for step in range(game.steps)):
            return "incomplete in this log"
    return ""


def is_dataset(folder: Path) -> bool:
    """Whether a folder is a LeRobot data set."""
    return (folder / "meta" / "info.json").is_file()


def _line(reason: str, games: list[str]) -> str:
    names = ", ".join(games[:10]) + (", ..." if len(games) > 10 else "")
    return f"left out: {len(games)} {'game' if len(games) == 1 else 'games'} {reason} ({names})"


def _part_of(progress: Progress, number: int, count: int) -> Progress:
    return lambda what, part: progress(what, (number + part) / count)


def _write_games(log: Log, parts: Sequence[Path], games: list[GameOutline], writer: _Writer, progress: Progress) -> None:
    keys = _KEYS + (_VIEWS if writer.views else ())
    for game, step, messages in steps_of(log, games, keys, progress):
        if step < game.steps:
            writer.add(game, step, messages)
        if step == game.steps - 1:
            writer.end_episode(game, parts[0].name)


class _Writer:
    """Writes frames, a row group at a time, and at the end what `meta/` says of them."""

    def __init__(self, arrow: Any, folder: Path, looks: Appearance, views: bool) -> None:
        self.views = views
        self.episodes = self.frames = 0
        self._arrow = arrow
        self._parquet = optional("pyarrow.parquet", "pyarrow")
        self._image = optional("PIL.Image", "pillow")
        self._folder = folder
        self._palette = looks.palette
        self._sizes: dict[str, tuple[int, int]] = {}
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
        for robot in ROBOTS:
            color = cast(ColorImage, messages[f"{robot}/color"])
            pixels = np.frombuffer(color.data, np.uint8).reshape(color.height, color.width, 3)
            self._add_picture(f"observation.images.{robot}_color", pixels)
            if self.views:
                view = cast(StateImage, messages[f"{robot}/view"])
                indices = np.frombuffer(view.data, np.uint8).reshape(STATE_IMAGE_SIZE, STATE_IMAGE_SIZE)
                self._add_picture(f"observation.images.{robot}_view", np.take(self._palette, indices, axis=0, mode="clip"))
            depth = cast(DepthImage, messages[f"{robot}/depth"])
            distances = np.frombuffer(depth.data, "<u2").reshape(depth.height, depth.width)
            self._rows.setdefault(f"observation.depth.{robot}", []).append(distances)
            self._histograms.setdefault(f"observation.depth.{robot}", Histogram(1, 1 << 16, 1.0, (1, 1))).add(distances)
        done = step == game.steps - 1
        self._add_numbers("observation.state", _pose(messages["hider/pose"]))
        self._add_numbers("action", _action(game, "hider", step, messages))
        self._add_numbers("privileged.seeker_state", _pose(messages["seeker/pose"]))
        self._add_numbers("privileged.seeker_action", _action(game, "seeker", step, messages))
        self._add_numbers("next.done", done)
        self._add_numbers("next.success", done and game.episode.outcome == "survived")
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
            "vantage/hider": said.players.hider,
            "vantage/seeker": said.players.seeker,
            "vantage/obstacles": json.dumps(boxes),
            "vantage/log": log_name,
        }
        for name, found in statistics.items():
            entry |= {f"stats/{name}/{kind}": value for kind, value in as_lists(found).items()}
        self._entries.append(entry)
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
        (self._folder / "README.md").write_text(form.card(fps))
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
            self._features = form.features_of(self._sizes, self.views)
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
