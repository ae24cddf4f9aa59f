"""`vantage collect`: play many games in process, far faster than real time, and log them.

Each worker process runs the real cores on the in-process bus under a virtual clock and writes one log per block of episodes, so
a log depends on its settings alone: the same command makes the same bytes of every message.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import count, islice
from multiprocessing.queues import Queue
from pathlib import Path
from queue import Empty
from typing import Annotated, Any

import msgspec
import psutil
import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from learning.hiders.core import HiderCore
from learning.hiders.policy import HiderPolicy
from learning.hiders.recorded import NO_TRAJECTORIES, TrajectoriesBySplit, read_trajectories, trajectories_hash
from learning.hiders.table import HIDERS, policy_generator
from learning.in_process import play
from learning.splits import SPLITS, split_of
from learning.stretches import RefereeOfStretches, stretches
from schemas import Episode, Players, Rules
from services.referee.settings import RefereeSettings
from services.seeker.core import SeekerCore, SeekerSettings
from services.simulator.core import SimulatorCore, SimulatorSettings
from vantage.cores import available_cores
from vantage.log import LogWriter, RunMetadata, open_log, source_commit
from vantage.play import SeekerPreset
from vantage.service import Core
from vantage.world.layout import ImpossibleLayout, make_layout

EVERY_SPLIT = frozenset(range(len(SPLITS)))
EPOCH = 1_767_225_600_000_000_000  # ns, 2026-01-01: the virtual clock of episode 1
EPISODE_SPACING = 1000 * 1_000_000_000  # ns of virtual time an episode may take
LARGEST_SEED = (2**63 - 1 - EPOCH) // EPISODE_SPACING - 1  # stamps are int64


@dataclass(frozen=True)
class CollectSettings:
    """Gather data: parallel games in simulation, MCAP logs out.

    Examples:
      vantage collect --episodes 4500 --hider goal-walk --to logs/
      vantage collect --episodes 300 --hider scripted --rules.no-catching --to evader/
      vantage collect --episodes 1500 --hider replay --from evader/ --to logs/
      vantage collect --episodes 1500 --hider replay --from recordings/ --driver human --to logs/
    """

    episodes: int = 100
    """How many games."""
    hider: str = "goal-walk"
    """Policy of the hider: a row of the hider table (random, goal-walk, scripted, scripted-1..3, replay)."""
    seeker: SeekerPreset = "glancing"
    """Preset of the seeker."""
    to: Path = Path("logs")
    """Folder for the logs."""
    source: Annotated[Path | None, tyro.conf.arg(name="from")] = None
    """Logs whose hider trajectories `--hider replay` plays, from other starts."""
    driver: str | None = None
    """Of those logs only the games that this hider drove: `human`, `planner`, `scripted-1`, ...; default: all."""
    seed: int = 1
    """Seed of the first episode; the next ones follow, without those of splits that have nothing to replay."""
    workers: int = 0
    """Worker processes; 0 = one for each core."""
    block: int = 50
    """Episodes per log."""
    views: bool = False
    """Also log the state images (training sets draw them again from the pictures)."""
    rules: Rules = field(default_factory=lambda: Rules(maximum_steps=200))
    world: tyro.conf.OmitArgPrefixes[SimulatorSettings] = field(default_factory=SimulatorSettings)


def main(settings: CollectSettings) -> int:
    """Collect; returns the exit code."""
    if settings.hider not in HIDERS:
        print(f"there is no hider `{settings.hider}`; the table has {', '.join(HIDERS)}", file=sys.stderr)
        return 2
    if settings.episodes < 1 or settings.seed < 0 or settings.seed + settings.episodes - 1 > LARGEST_SEED:
        print(f"--episodes must be at least 1 and seeds lie in 0 .. {LARGEST_SEED:,}: choose another --seed", file=sys.stderr)
        return 2
    try:
        make_layout(settings.rules.layout, settings.seed)
    except ImpossibleLayout as error:
        print(error, file=sys.stderr)
        return 2
    trajectories = NO_TRAJECTORIES
    playable = EVERY_SPLIT
    if settings.hider == "replay":
        if settings.source is None:
            print("`--hider replay` needs the recorded trajectories: --from FOLDER", file=sys.stderr)
            return 2
        try:
            found = read_trajectories(settings.source, settings.driver)
        except FileNotFoundError as error:
            print(error, file=sys.stderr)
            return 2
        trajectories = found.by_split
        if not any(trajectories):
            wanted = f" that `{settings.driver}` drove" if settings.driver else ""
            print(f"{settings.source} holds no hider trajectory{wanted}: {found}", file=sys.stderr)
            return 2
        print(f"{settings.source}: {found}")
        playable = frozenset(split for split, of_split in enumerate(trajectories) if of_split)
        if lacking := [name for name, of_split in zip(SPLITS, trajectories, strict=True) if not of_split]:
            print(
                f"seeds of the splits {', '.join(lacking)} are left out, for which nothing was recorded: an episode replays only "
                "what was recorded in its own split, so that no path is in training and in test"
            )
    settings.to.mkdir(parents=True, exist_ok=True)
    _remove_partial_logs(settings.to)
    recorded = trajectories_hash(trajectories)
    blocks = blocks_of(settings, playable)
    starts = {block[0] for block in blocks}
    crumbs = crumbs_of(settings, playable)
    if any(crumb[0] not in starts and log_path(settings, crumb).exists() for crumb in crumbs):
        blocks = crumbs  # begun when a log had no gaps in its seeds
    first, last = (settings.seed + block[end] - 1 for block, end in ((blocks[0], 0), (blocks[-1], -1)))
    print(f"{settings.episodes} games with seeds {first} to {last}, in {len(blocks)} logs")
    waiting: list[Sequence[int]] = []
    for block in blocks:
        path = log_path(settings, block)
        held = configuration_in(path) if path.exists() else {}
        if held and not is_same(held["settings"], configuration_of(settings, block)["settings"]):
            print(f"{path} was made with other settings: choose another folder with --to, or remove it", file=sys.stderr)
            return 2
        if held and held.get("trajectories", recorded) != recorded:
            print(f"{path} replays other trajectories: choose another folder with --to, or remove it", file=sys.stderr)
            return 2
        if held.get("games") != len(block):
            waiting.append(block)
    if len(waiting) < len(blocks):
        print(f"{len(blocks) - len(waiting)} of {len(blocks)} logs are there already and are kept")
    console = Console()
    workers = min(settings.workers or available_cores(), max(len(waiting), 1))
    total = sum(map(len, waiting))
    started = time.monotonic()
    columns = (TextColumn("collecting"), BarColumn(), MofNCompleteColumn(), TextColumn("games  {task.fields[rate]}"))
    steps = games = 0
    with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console) as progress:
        task = progress.add_task("collect", total=total, rate="")
        for played, stepped in _play_blocks(settings, waiting, trajectories, workers):
            games += played
            steps += stepped
            progress.update(task, completed=games, rate=f"{steps / (time.monotonic() - started):,.0f} steps/s")
    elapsed = time.monotonic() - started
    rate = f"{steps / elapsed:,.0f} steps/s with {workers} workers"
    print(f"{games} games, {steps} steps in {elapsed:.1f} s: {rate}, in {settings.to}/")
    if games < total:
        print("workers failed (see above); run the command again to go on", file=sys.stderr)
        return 1
    return 0


def episodes_of(settings: CollectSettings, playable: frozenset[int] = EVERY_SPLIT) -> list[int]:
    """Return the episodes to play, the first of all counted as 1; those of splits that are not playable are left out."""
    wanted = (episode for episode in count(1) if split_of(settings.seed + episode - 1) in playable)
    return list(islice(wanted, settings.episodes))


def blocks_of(settings: CollectSettings, playable: frozenset[int] = EVERY_SPLIT) -> list[Sequence[int]]:
    """Return the episodes of each log."""
    episodes = episodes_of(settings, playable)
    return [episodes[start : start + settings.block] for start in range(0, len(episodes), settings.block)]


def crumbs_of(settings: CollectSettings, playable: frozenset[int]) -> list[Sequence[int]]:
    """Return the episodes of each log of a collection that was begun when a log could have no gaps."""
    whole = stretches(episodes_of(settings, playable))
    return [stretch[start : start + settings.block] for stretch in whole for start in range(0, len(stretch), settings.block)]


def configuration_of(
    settings: CollectSettings, block: Sequence[int], trajectories: TrajectoriesBySplit = NO_TRAJECTORIES
) -> dict[str, Any]:
    """Return what a log says of its making: nothing that depends on where or when it was made."""
    portable = replace(settings, to=Path(), source=None, driver=None, workers=0, episodes=0)
    plain = json.dumps(asdict(portable), default=lambda value: msgspec.to_builtins(value, enc_hook=str))
    return {"settings": json.loads(plain), "games": len(block), "trajectories": trajectories_hash(trajectories)}


def is_same(held: dict[str, Any], settings: dict[str, Any]) -> bool:
    """Return whether a log was made with these settings; what is None has no part in it, by whatever name it went."""
    return {name: value for name, value in held.items() if value is not None} == {
        name: value for name, value in settings.items() if value is not None
    }


def configuration_in(path: Path) -> dict[str, Any]:
    """Return the configuration that a log was made with; empty when it cannot be read."""
    try:
        with open_log(path) as log:
            found = json.loads(log.metadata.get("configuration", "{}"))
    except (OSError, ValueError):
        return {}
    return found if "settings" in found else {}


def log_path(settings: CollectSettings, block: Sequence[int]) -> Path:
    """Return the log of a block of episodes."""
    return settings.to / f"{settings.hider}_{settings.seeker}_{settings.seed + block[0] - 1:07d}.mcap"


def play_block(
    settings: CollectSettings, block: Sequence[int], path: Path, trajectories: TrajectoriesBySplit = NO_TRAJECTORIES
) -> int:
    """Play a block of episodes into one log. Returns the number of steps played."""

    def make_policy(episode: Episode) -> HiderPolicy:
        generator = policy_generator(episode.seed)
        return HIDERS[settings.hider](episode.rules.maximum_steps, generator, trajectories[split_of(episode.seed)])

    first = settings.seed + block[0] - 1  # episode numbers are seeds, so that they are unique over a whole collection
    referee = RefereeSettings(
        autoplay=True,
        rules=settings.rules,
        players=Players(hider=settings.hider, seeker=settings.seeker),
        required=("simulator", "seeker", "hider"),
        settle=0.0,
    )
    seeds = stretches(settings.seed + episode - 1 for episode in block)
    cores: dict[str, Core] = {
        "simulator": SimulatorCore(settings.world),
        "seeker": SeekerCore(SeekerSettings(publish_view=settings.views)),
        "hider": HiderCore(make_policy, publish_view=settings.views),
        "referee": RefereeOfStretches(
            [replace(referee, games=len(stretch), seed=stretch[0], first_episode=stretch[0]) for stretch in seeds]
        ),
    }
    metadata = RunMetadata(
        commit=source_commit(),
        configuration=json.dumps(configuration_of(settings, block, trajectories)),
        started=EPOCH + first * EPISODE_SPACING,
    )
    partial = path.with_suffix(f".{os.getpid()}.partial")  # two processes never write the same file
    # No flush by the wall clock: chunks, and so the file's bytes, depend on the messages alone.
    with LogWriter(partial, metadata, compression="lz4", sync=False, flush_period=2**62) as writer:
        steps = play(cores, len(block), EPOCH + first * EPISODE_SPACING, writer)
    partial.replace(path)
    return steps


def _remove_partial_logs(folder: Path) -> None:
    """Remove what workers that are no more left unfinished."""
    for path in folder.glob("*.partial"):
        writer = path.suffixes[-2][1:] if len(path.suffixes) > 1 else ""
        if not (writer.isdecimal() and psutil.pid_exists(int(writer))):
            path.unlink(missing_ok=True)


def _play_blocks(
    settings: CollectSettings, blocks: list[Sequence[int]], trajectories: TrajectoriesBySplit, workers: int
) -> Iterator[tuple[int, int]]:
    """Play blocks into their logs; yields games and steps of each as it is done, of fewer blocks where a worker failed."""
    if workers == 1:
        for block in blocks:
            yield len(block), play_block(settings, block, log_path(settings, block), trajectories)
        return
    context = multiprocessing.get_context("spawn")
    done: Queue[tuple[int, int]] = context.Queue()
    processes = [
        context.Process(target=_work, args=(settings, blocks[index::workers], trajectories, done), daemon=True)
        for index in range(workers)
    ]
    for process in processes:
        process.start()
    left = len(blocks)
    while left:
        alive = any(process.is_alive() for process in processes)
        try:
            yield done.get(timeout=1.0)
        except Empty:
            if not alive:
                break
        else:
            left -= 1
    for process in processes:
        process.join()


def _work(
    settings: CollectSettings, blocks: list[Sequence[int]], trajectories: TrajectoriesBySplit, done: Queue[tuple[int, int]]
) -> None:
    parent = multiprocessing.parent_process()
    for block in blocks:
        if parent is not None and not parent.is_alive():  # killed: nobody waits for this
            return
        steps = play_block(settings, block, log_path(settings, block), trajectories)
        done.put((len(block), steps))
