"""`vantage convert`: logs -> training set. State images are drawn again from the logged pictures, as the planner draws them."""

from __future__ import annotations

import hashlib
import json
import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import lz4.block
import numpy as np
import tyro
from numpy.typing import NDArray
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from learning.dataset import DEFAULT_DATASET, EPISODE, PLAN, SCHEMA_VERSION, STEP, UnusableDataset, key_of
from learning.dataset_tables import Sizes, by_split, episodes_chosen, names_counted, rows_kept, shift_rows
from learning.splits import SPLITS, split_of
from learning.workers import results_of, worker_count
from schemas import ROBOTS
from vantage.log import find_logs, open_log, source_commit
from vantage.log.episodes import EPISODE_TOPICS, EpisodeLog, games_of
from vantage.log.file import DAMAGE
from vantage.log.games import unusable
from vantage.log.reader import Log
from vantage.output import AlreadyExists, complete, remove_abandoned
from vantage.perception.state_image import perceive
from vantage.printable import counted, printable

NAMES = ("hider", "seeker", "layout")
TOPICS = EPISODE_TOPICS - {"tick", "hider/command", "seeker/command", "hider/view", "seeker/view"}


@dataclass(frozen=True)
class ConvertSettings:
    """Turn logs into a training set.

    Examples:
      vantage convert
      vantage convert logs/ recordings/ --to data/both
    """

    logs: Annotated[tuple[Path, ...], tyro.conf.Positional] = (Path("logs"),)
    """Logs, or folders that hold them."""
    to: Path = DEFAULT_DATASET
    """Folder of the training set."""
    force: bool = False
    """Replace an older training set; nothing else is ever replaced."""
    workers: int = 0
    """Worker processes; 0 = one for each core."""


@dataclass
class Part:
    """The episodes of one log, with rows counted from 0."""

    episodes: list[tuple[object, ...]] = field(default_factory=list)
    steps: list[tuple[object, ...]] = field(default_factory=list)
    plans: list[tuple[int, int, int]] = field(default_factory=list)
    positions: list[NDArray[np.float32]] = field(default_factory=list)
    position_count: int = 0
    images: list[bytes] = field(default_factory=list)
    plan_counts: list[int] = field(default_factory=list)  # of each episode
    left_out: Counter[str] = field(default_factory=Counter)
    names: dict[str, set[str]] = field(default_factory=lambda: {name: set() for name in NAMES})


@dataclass
class Converted:
    """One converted log.

    Attributes:
        tables: rows counted from 0, by name.
        images: how many state images are in the log's file.
        left_out: reason -> games.
        names: whole names of hiders, seekers and layouts.
        hash: of the log's messages.
        broken: what of the log could not be read; empty when all could.
        recording: whether the log is being recorded now.
    """

    tables: dict[str, NDArray[Any]] = field(default_factory=dict)
    images: int = 0
    left_out: Counter[str] = field(default_factory=Counter)
    names: dict[str, set[str]] = field(default_factory=dict)
    hash: str = ""
    broken: str = ""
    recording: bool = False

    @property
    def left_out_because(self) -> str:
        """Why the log is left out, and what to do; empty when it is not."""
        if self.recording:
            return "it is being recorded now: convert it again when it is finished"
        return f"{self.broken}: `vantage log recover` saves what is whole" if self.broken else ""


def convert_games(games: Iterable[EpisodeLog]) -> Part:
    """Return the training episodes among some games; those that cannot serve are counted by reason."""
    part = Part()
    for game in games:
        reason = _unusable(game)
        if reason:
            part.left_out[reason] += 1
        else:
            _add(part, game)
    return part


def _unusable(game: EpisodeLog) -> str:
    """Return why a game cannot serve, or nothing."""
    if reason := unusable(game):
        return reason
    if not game.episode.rules.catching:
        return "catches ignored (an evader's trajectory, to be replayed)"
    if not any(plan.path for plan in game.plans.values()):
        return "no planned path"
    if 0 not in game.plans:
        return "no plan from the start on"
    return ""


def _add(part: Part, game: EpisodeLog) -> None:
    head = game.episode
    last = game.steps if head.caught_step is None else head.caught_step
    first_step, first_plan = len(part.steps), len(part.plans)
    plan_steps = sorted(step for step, plan in game.plans.items() if plan.path)
    for step in plan_steps:
        positions = np.frombuffer(game.plans[step].path, "<f4").reshape(-1, 3)
        part.plans.append((step, part.position_count, len(positions)))
        part.positions.append(positions)
        part.position_count += len(positions)
    part.plan_counts.append(len(plan_steps))
    for step in range(last + 1):
        in_force = int(np.searchsorted(plan_steps, step, side="right")) - 1
        poses = []
        for robot in ROBOTS:
            pose = game.poses[robot][step]
            view = perceive(game.depths[robot][step], game.colors[robot][step], pose, robot)
            part.images.append(lz4.block.compress(view.image, store_size=False))
            poses.append((pose.x, pose.y, pose.heading))
        part.steps.append((*poses, first_plan + in_force if in_force >= 0 else -1))
    names = {"hider": head.players.hider, "seeker": head.players.seeker, "layout": head.rules.layout}
    for name, text in names.items():
        part.names[name].add(text)
    part.episodes.append(
        (
            head.episode,
            head.seed,
            *(key_of(text, name) for name, text in names.items()),
            first_step,
            last + 1,
            -1 if head.caught_step is None else head.caught_step,
            head.rules.maximum_steps,
            split_of(head.seed),
        )
    )


def _convert_log(task: tuple[list[Path], Path]) -> Converted:
    """Convert one log; its images go to a file."""
    parts, images = task
    with open_log(*parts) as log:
        try:
            part, hash = convert_games(games_of(log, TOPICS)), messages_hash(log)
        except DAMAGE as error:
            if not log.breaks:
                raise
            return Converted(broken=f"{log.breaks[0]} ({error})")
        if log.recording:
            return Converted(recording=True)
        if not all(file.finished for file in log.files):
            return Converted(broken=log.breaks[0] if log.breaks else "it was cut short")
        if log.breaks:
            return Converted(broken=log.breaks[0])
    with images.open("wb") as file:
        file.writelines(part.images)
    tables: dict[str, NDArray[Any]] = {
        "episodes": np.array(part.episodes, EPISODE),
        "steps": np.array(part.steps, STEP),
        "plans": np.array(part.plans, PLAN),
        "positions": np.concatenate(part.positions) if part.positions else np.empty((0, 3), np.float32),
        "lengths": np.array([len(image) for image in part.images], np.int64),
        "plan_counts": np.array(part.plan_counts, np.int64),
    }
    return Converted(tables, len(part.images), part.left_out, part.names, hash)


def messages_hash(log: Log) -> str:
    """Return the SHA-256 of the messages of a log: not of its file, which names the commit that made it.

    What is damaged is left out, and noted in the log's `breaks`.
    """
    digest = hashlib.sha256()
    for file in log.files:
        with file.path.open("rb") as stored:
            for chunk in file.chunks:
                if chunk.compression == "lz4":
                    try:
                        digest.update(file.bytes_of(chunk))
                    except DAMAGE as error:
                        file.breaks.append(f"damaged chunk at byte {chunk.offset}: {error}")
                elif chunk.compression is not None:
                    stored.seek(chunk.offset)
                    digest.update(stored.read(chunk.length))
    return digest.hexdigest()


def convert(
    sources: Iterable[Path],
    to: Path,
    workers: int = 0,
    quiet: bool = False,
    wanted: Mapping[str, Sizes] | None = None,
    force: bool = False,
    need_every_log: bool = False,
) -> dict[str, Any]:
    """Convert logs into a training set; returns its manifest. Logs that are cut short or damaged are left out, with a line each.

    Args:
        quiet: show no progress.
        wanted: hider -> how many of its games each split is to have: those of the lowest seeds. None = all games.
        force: replace a training set that is there.
        need_every_log: leave no log out.

    Raises:
        NoSuchLog: there are no logs.
        TooFewGames: fewer games can serve than are wanted; what is in `to` is left as it was.
        AlreadyExists: see `force`.
        UnusableDataset: no game in the logs can serve, a log is broken that must not be left out, or `to` exists and is no
            training set: then it is not replaced.
        OSError: of the disk; what is in `to` is left as it was.
    """
    is_empty = to.is_dir() and not any(to.iterdir())
    if to.exists() and not (to / "manifest.json").is_file() and not is_empty:
        raise UnusableDataset(f"{to} exists and is no training set, so it is not replaced: choose another --to")
    if to.exists() and not is_empty and not force:
        raise AlreadyExists(to, "choose another name with --to, or replace it with --force")
    logs = sorted({tuple(parts) for source in sources for parts in find_logs(source)})
    remove_abandoned(to.parent)
    with complete(to) as partial:
        partial.mkdir()
        tasks = [(list(parts), partial / f"images.{number:06d}") for number, parts in enumerate(logs)]
        found = _convert_logs(tasks, workers, quiet)
        broken = [(parts[0], one) for (parts, _), one in zip(tasks, found, strict=True) if one.left_out_because]
        if need_every_log and broken:
            path, one = broken[0]
            why = one.broken or "it is being recorded now"
            raise UnusableDataset(printable(f"{path}: {why}: remove this log and run it again, its games are then played again"))
        for path, one in broken:
            print(printable(f"left out: {path}: {one.left_out_because}"), file=sys.stderr)
        manifest = _write(partial, tasks, found, wanted, to)
    return manifest


def _convert_logs(tasks: list[tuple[list[Path], Path]], workers: int, quiet: bool) -> list[Converted]:
    """Convert every log."""
    found = [Converted() for _ in tasks]
    columns = (TextColumn("converting"), BarColumn(), MofNCompleteColumn(), TextColumn("logs"))
    with (
        Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), disable=quiet) as progress,
        closing(results_of(_convert_log, tasks, worker_count(workers, len(tasks)))) as results,
    ):
        bar = progress.add_task("convert", total=len(tasks))
        for index, converted in results:
            found[index] = converted
            progress.advance(bar)
    return found


def _write(
    partial: Path, tasks: list[tuple[list[Path], Path]], found: list[Converted], wanted: Mapping[str, Sizes] | None, to: Path
) -> dict[str, Any]:
    """Write the training set from the tables and image files of its logs; returns the manifest."""
    whole = [
        (parts, piece, converted)
        for (parts, piece), converted in zip(tasks, found, strict=True)
        if not converted.left_out_because
    ]
    left_out = sum((converted.left_out for _, _, converted in whole), Counter[str]())
    if not any(converted.images for _, _, converted in whole):
        reasons = [f"{count} {printable(reason)}" for reason, count in left_out.items()]
        if broken := len(tasks) - len(whole):
            reasons.append(f"{counted(broken, 'log')} broken")
        raise UnusableDataset(
            f"no game in {counted(len(tasks), 'log')} can serve ({', '.join(reasons) or 'there is none'}); {to} is left as it was"
        )
    parts_of_tables = [converted.tables for _, _, converted in whole]
    tables = {name: np.concatenate([part[name] for part in parts_of_tables]) for name in parts_of_tables[0]}
    shift_rows(tables, parts_of_tables)
    lengths, kept = tables["lengths"], np.ones(len(tables["episodes"]), np.bool_)
    if wanted is not None:
        kept = episodes_chosen(tables["episodes"], wanted)
        left_out["beyond the wanted size"] += int((~kept).sum())
    image_kept = np.repeat(np.repeat(kept, tables["episodes"]["steps"]), 2)
    tables = rows_kept(tables, kept, image_kept)
    digest = hashlib.sha256()
    first = 0
    with (partial / "images.lz4").open("wb") as out:
        for _, piece, converted in whole:
            own = slice(first, first := first + converted.images)
            data = np.frombuffer(piece.read_bytes(), np.uint8)
            if not image_kept[own].all():
                data = data[np.repeat(image_kept[own], lengths[own])]
            digest.update(data.data)
            out.write(data.data)
            piece.unlink()
    lengths = tables.pop("lengths")
    tables["offsets"] = np.concatenate([np.zeros(1, np.int64), np.cumsum(lengths, dtype=np.int64)])
    for name, table in tables.items():
        np.save(partial / f"{name}.npy", table)
        digest.update(table.tobytes())
    episodes = tables["episodes"]
    manifest: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "commit": source_commit(),
        "hash": digest.hexdigest(),
        "episodes": {split: int((episodes["split"] == number).sum()) for number, split in enumerate(SPLITS)},
        **{
            f"{name}s": names_counted(episodes[name], name, [converted.names[name] for _, _, converted in whole])
            for name in NAMES
        },
        "horizons": sorted({int(horizon) for horizon in episodes["horizon"]}),
        "caught": int((episodes["caught_step"] >= 0).sum()),
        "steps": len(tables["steps"]),
        "left_out": dict(sorted(left_out.items())),
        "logs": {parts[0].name: converted.hash for parts, _, converted in whole},
    }
    (partial / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n")
    return manifest


def warn_of_empty_splits(manifest: Mapping[str, Any]) -> None:
    """Print on stderr which splits of a training set are empty."""
    if empty := [split for split, count in manifest["episodes"].items() if not count]:
        print(f"warning: no {' and no '.join(empty)} games: nothing can be drawn from there; gather more", file=sys.stderr)


def summary_of(manifest: Mapping[str, Any]) -> str:
    """Return in one line what is in a training set."""
    hiders = ", ".join(f"{count:,} {printable(hider)}" for hider, count in manifest["hiders"].items())
    games = counted(sum(manifest["episodes"].values()), "game")
    return f"{games} ({by_split(manifest['episodes'].values())}; by hider {hiders}), {manifest['steps']:,} steps"


def main(settings: ConvertSettings) -> int:
    """Convert; returns the exit code."""
    manifest = convert(settings.logs, settings.to, settings.workers, force=settings.force)
    warn_of_empty_splits(manifest)
    print(f"{summary_of(manifest)}, in {settings.to}")
    if manifest["left_out"]:
        reasons = ", ".join(f"{count:,} {printable(reason)}" for reason, count in manifest["left_out"].items())
        print(f"games left out: {reasons}", file=sys.stderr)
    return 0
