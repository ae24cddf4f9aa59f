"""`vantage convert`: logs -> training set. State images are drawn again from the logged pictures, as the planner draws them."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import shutil
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import lz4.block
import lz4.frame
import numpy as np
import tyro
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from learning.dataset import EPISODE, PLAN, SCHEMA_VERSION, STEP, UnusableDataset
from learning.splits import SPLITS, split_of
from schemas import ROBOTS
from vantage.cores import available_cores
from vantage.log import find_logs, open_log, source_commit
from vantage.log.episodes import EPISODE_TOPICS, EpisodeLog, games_of
from vantage.log.games import unusable
from vantage.perception.state_image import perceive

Sizes = tuple[int, int, int]
"""Games of the training, validation and test split."""

TOPICS = EPISODE_TOPICS - {"tick", "hider/command", "seeker/command", "hider/view", "seeker/view"}


@dataclass(frozen=True)
class ConvertSettings:
    """Turn logs into a training set.

    Example: vantage convert logs/ --to dataset/
    """

    logs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Logs, or folders that hold them."""
    to: Path = Path("dataset")
    """Folder of the training set; an older one there is replaced."""
    workers: int = 0
    """Processes; 0 = one for each core."""


class TooFewGames(UnusableDataset):
    """Fewer games can serve than are wanted; `lacking` says how many, hider -> by split."""

    def __init__(self, lacking: dict[str, Sizes]) -> None:
        self.lacking = lacking
        counts = (f"{dict(zip(SPLITS, sizes, strict=True))} of `{hider}`" for hider, sizes in lacking.items())
        super().__init__(f"the logs hold too few games, lacking are {', '.join(counts)}: gather more")


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
    part.episodes.append(
        (
            head.episode,
            head.seed,
            head.players.hider.encode()[:32],
            head.players.seeker.encode()[:16],
            head.rules.layout.encode()[:64],
            first_step,
            last + 1,
            -1 if head.caught_step is None else head.caught_step,
            head.rules.maximum_steps,
            split_of(head.seed),
        )
    )


def _convert_log(task: tuple[list[Path], Path]) -> tuple[dict[str, NDArray[Any]], int, Counter[str], str]:
    """Convert one log; its images go to a file, its tables are returned with the log's hash."""
    parts, images = task
    with open_log(*parts) as log:
        part = convert_games(games_of(log, TOPICS))
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
    return tables, len(part.images), part.left_out, messages_hash(parts)


def messages_hash(parts: Iterable[Path]) -> str:
    """Return the SHA-256 of all that was said in a log: not of its file, which names the commit that made it."""
    digest = hashlib.sha256()
    for path in parts:
        with path.open("rb") as file:
            for record in StreamReader(file, emit_chunks=True).records:
                if isinstance(record, Chunk):
                    digest.update(lz4.frame.decompress(record.data) if record.compression == "lz4" else record.data)
    return digest.hexdigest()


def convert(
    sources: Iterable[Path], to: Path, workers: int = 0, quiet: bool = False, wanted: Mapping[str, Sizes] | None = None
) -> dict[str, object]:
    """Convert logs into a training set; returns its manifest.

    Args:
        wanted: hider -> how many of its games each split is to have: those of the lowest seeds. None = all games.

    Raises:
        FileNotFoundError: there are no logs.
        TooFewGames: fewer games can serve than are wanted; what is in `to` is left as it was.
        UnusableDataset: no logs are named, or no game in them can serve, or `to` exists and is no training set: then it is
            not replaced.
    """
    if to.exists() and not (to / "manifest.json").is_file() and not _is_empty_folder(to):
        raise UnusableDataset(f"{to} exists and is no training set, so it is not replaced: choose another --to")
    if not (sources := tuple(sources)):
        raise UnusableDataset("name the logs: vantage convert logs/ --to dataset/")
    logs = sorted({tuple(parts) for source in sources for parts in find_logs(source)})
    partial = to.with_name(to.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    tasks = [(list(parts), partial / f"images.{number:06d}") for number, parts in enumerate(logs)]
    results = []
    left_out: Counter[str] = Counter()
    columns = (
        TextColumn("converting"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("logs"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, disable=quiet) as progress:
        bar = progress.add_task("convert", total=len(tasks))
        for result in _map(tasks, workers):
            results.append(result)
            left_out += result[2]
            progress.advance(bar)
    tables = {name: np.concatenate([result[0][name] for result in results]) for name in results[0][0]}
    _shift_rows(tables, [result[0] for result in results])
    lengths, kept = tables["lengths"], np.ones(len(tables["episodes"]), np.bool_)
    if wanted is not None:
        try:
            kept = _chosen(tables["episodes"], wanted)
        except TooFewGames:
            shutil.rmtree(partial)
            raise
        left_out["beyond the wanted size"] += int((~kept).sum())
    image_kept = np.repeat(np.repeat(kept, tables["episodes"]["steps"]), 2)
    tables = _only(tables, kept, image_kept)
    digest = hashlib.sha256()
    first = 0
    with (partial / "images.lz4").open("wb") as out:
        for (_, piece), (_, count, _, _) in zip(tasks, results, strict=True):
            own = slice(first, first := first + count)
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
    manifest: dict[str, object] = {
        "schema_version": SCHEMA_VERSION,
        "commit": source_commit(),
        "hash": digest.hexdigest(),
        "episodes": {split: int((episodes["split"] == number).sum()) for number, split in enumerate(SPLITS)},
        "hiders": dict(sorted(Counter(name.decode() for name in episodes["hider"]).items())),
        "seekers": dict(sorted(Counter(name.decode() for name in episodes["seeker"]).items())),
        "layouts": dict(sorted(Counter(name.decode() for name in episodes["layout"]).items())),
        "horizons": sorted({int(horizon) for horizon in episodes["horizon"]}),
        "caught": int((episodes["caught_step"] >= 0).sum()),
        "steps": len(tables["steps"]),
        "left_out": dict(sorted(left_out.items())),
        "logs": {parts[0].name: result[3] for (parts, _), result in zip(tasks, results, strict=True)},
    }
    (partial / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n")
    if not len(tables["steps"]):
        shutil.rmtree(partial)
        why = ", ".join(f"{count} {reason}" for reason, count in left_out.items()) or "they hold none"
        raise UnusableDataset(f"no game in {len(tasks)} logs can serve ({why}); {to} is left as it was")
    shutil.rmtree(to, ignore_errors=True)
    partial.rename(to)
    return manifest


def _is_empty_folder(path: Path) -> bool:
    return path.is_dir() and not any(path.iterdir())


def _map(tasks: list[tuple[list[Path], Path]], workers: int) -> Iterator[tuple[dict[str, NDArray[Any]], int, Counter[str], str]]:
    workers = min(workers or available_cores(), len(tasks))
    if workers <= 1:
        yield from map(_convert_log, tasks)
        return
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield from pool.imap(_convert_log, tasks)


def _shift_rows(tables: dict[str, NDArray[Any]], parts: list[dict[str, NDArray[Any]]]) -> None:
    """Turn row numbers within a log into row numbers within the whole."""
    done: Counter[str] = Counter()
    for part in parts:
        episodes, steps, plans = (slice(done[name], done[name] + len(part[name])) for name in ("episodes", "steps", "plans"))
        tables["episodes"]["first_step"][episodes] += done["steps"]
        in_force = tables["steps"]["plan"][steps]
        in_force[in_force >= 0] += done["plans"]
        tables["plans"]["first_position"][plans] += done["positions"]
        for name in ("episodes", "steps", "plans", "positions"):
            done[name] += len(part[name])


def _chosen(episodes: NDArray[Any], wanted: Mapping[str, Sizes]) -> NDArray[np.bool_]:
    """Return which episodes [n] make up the wanted sizes: of each hider and split those of the lowest seeds."""
    kept = np.zeros(len(episodes), np.bool_)
    lacking = {}
    for hider, sizes in wanted.items():
        of_hider = episodes["hider"] == hider.encode()[:32]
        short = [0, 0, 0]
        for split, size in enumerate(sizes):
            rows = np.flatnonzero(of_hider & (episodes["split"] == split))
            kept[rows[np.argsort(episodes["seed"][rows], kind="stable")][:size]] = True
            short[split] = max(0, size - len(rows))
        if any(short):
            lacking[hider] = (short[0], short[1], short[2])
    if lacking:
        raise TooFewGames(lacking)
    return kept


def _only(tables: dict[str, NDArray[Any]], kept: NDArray[np.bool_], image_kept: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """Return the tables without the episodes that are not kept [n]."""
    steps, plans = image_kept[::2], np.repeat(kept, tables["plan_counts"])
    only = {
        "episodes": tables["episodes"][kept],
        "steps": tables["steps"][steps],
        "plans": tables["plans"][plans],
        "positions": tables["positions"][np.repeat(plans, tables["plans"]["positions"])],
        "lengths": tables["lengths"][image_kept],
    }
    in_force = only["steps"]["plan"]
    in_force[:] = np.where(in_force >= 0, (np.cumsum(plans) - 1)[in_force], -1)
    for table, count, row in (("episodes", "steps", "first_step"), ("plans", "positions", "first_position")):
        counts = only[table][count].astype(np.int64)
        only[table][row] = np.cumsum(counts) - counts
    return only


def warn_of_empty_splits(manifest: Mapping[str, Any]) -> None:
    """Say on stderr which splits of a training set are empty."""
    if empty := [split for split, count in manifest["episodes"].items() if not count]:
        print(f"warning: no {' and no '.join(empty)} episodes: nothing can be drawn from there; gather more", file=sys.stderr)


def main(settings: ConvertSettings) -> int:
    """Convert; returns the exit code."""
    manifest = convert(settings.logs, settings.to, settings.workers)
    warn_of_empty_splits(manifest)
    print(f"{manifest['steps']} steps, episodes {manifest['episodes']}, by hider {manifest['hiders']}, in {settings.to}/")
    if manifest["left_out"]:
        print(f"left out: {manifest['left_out']}", file=sys.stderr)
    return 0
