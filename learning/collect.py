"""`vantage collect`: play many games in process, far faster than real time, and log them.

Each worker process runs the real cores on the in-process bus under a virtual clock and writes one log per block of games, so a
log depends on its settings alone: the same command makes the same bytes of every message.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count, islice
from pathlib import Path
from typing import Annotated, Any

import msgspec
import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from learning.collection import LARGEST_SEED, clock_of, find_collection, missing_blocks, option_of, plain
from learning.hiders.core import HiderCore
from learning.hiders.policy import HiderPolicy
from learning.hiders.recorded import NO_TRAJECTORIES, TrajectoriesBySplit, read_trajectories, trajectories_hash
from learning.hiders.table import HIDERS, policy_generator
from learning.in_process import play
from learning.splits import SPLITS, split_of
from learning.stretches import RefereeOfStretches, stretches
from learning.workers import results_of, worker_count
from schemas import Episode, Players, Rules
from services.referee.settings import RefereeSettings
from services.seeker.core import SeekerCore, SeekerSettings
from services.simulator.core import SimulatorCore, SimulatorSettings
from vantage.errors import UserError
from vantage.log import LogWriter, RunMetadata, source_commit
from vantage.match import SeekerPreset
from vantage.output import complete, remove_abandoned
from vantage.printable import counted, printable
from vantage.service import Core
from vantage.world.layout import ImpossibleLayout, make_layout

EVERY_SPLIT = frozenset(range(len(SPLITS)))


class ImpossibleCollection(UserError):
    """Games that cannot be collected; the text says why and what to do."""


@dataclass(frozen=True)
class CollectSettings:
    """Gather data: parallel games in simulation, MCAP logs out. Run it again to go on, or with more games to add to them.

    Examples:
      vantage collect --games 4500 --hider goal-walk --to logs/goal-walk
      vantage collect --games 300 --hider scripted --no-catching --to evader/
      vantage collect --games 1500 --hider replay --from evader/ --to logs/replay
      vantage collect --games 1500 --hider replay --from recordings/ --driver human --to logs/human
    """

    games: int = 100
    """How many games."""
    hider: str = "goal-walk"
    """Policy of the hider: a row of the hider table (random, goal-walk, scripted, scripted-1..3, replay)."""
    seeker: SeekerPreset = "glancing"
    """Preset of the seeker."""
    to: Path = Path("logs")
    """Folder for the logs; it holds games of one kind of settings."""
    source: Annotated[Path | None, tyro.conf.arg(name="from")] = None
    """Logs whose hider trajectories `--hider replay` plays, from other starts."""
    driver: str | None = None
    """Of those logs only the games that this hider drove: `human`, `planner`, `scripted-1`, ...; default: all."""
    seed: int = 1
    """Seed of the first game; the next ones follow, without those of splits that have nothing to replay."""
    steps: int = 200
    """Steps that the hider has to survive (T)."""
    layout: str = "random"
    """Arena: `random`, `lab`, or the path of a layout file."""
    period: float = 0.25
    """Seconds of virtual time that a step takes."""
    catching: bool = True
    """`--no-catching` ignores catches, to record an evader's whole action sequence."""
    catch_distance: float = 0.150
    """Metres between the robots' centres at or below which the hider is caught."""
    start_distance: tuple[float, float] = (0.250, 0.450)
    """Least and most metres between the robots' centres at the start."""
    workers: int = 0
    """Worker processes; 0 = one for each core."""
    block: int = 50
    """Games per log."""
    views: bool = False
    """Also log the state images (training sets draw them again from the pictures)."""
    world: tyro.conf.OmitArgPrefixes[SimulatorSettings] = field(default_factory=SimulatorSettings)

    @property
    def rules(self) -> Rules:
        """The rules of the games."""
        nearest, farthest = self.start_distance
        return Rules(
            maximum_steps=self.steps,
            catch_distance=self.catch_distance,
            catching=self.catching,
            start_distance_minimum=nearest,
            start_distance_maximum=farthest,
            layout=self.layout,
            step_period=self.period,
        )


def main(settings: CollectSettings) -> int:
    """Collect; returns the exit code."""
    check(settings)
    trajectories = _trajectories_for(settings) if settings.hider == "replay" else NO_TRAJECTORIES
    playable = frozenset(split for split, found in enumerate(trajectories) if found) if any(trajectories) else EVERY_SPLIT
    settings.to.mkdir(parents=True, exist_ok=True)
    remove_abandoned(settings.to)
    seeds = seeds_from(settings.seed, settings.games, playable)
    held = find_collection(settings.to, identity_of(settings, trajectories), partial(seeds_from, playable=playable))
    for path in held.damaged:
        print(f"{path} was cut short or lacks messages: its games are played again")
    blocks = missing_blocks(seeds, held.seeds, settings.block)
    if not blocks:
        print(f"{counted(len(held.seeds), 'game')} of these settings are in {settings.to} already: nothing to do")
        return 0
    print(f"{counted(settings.games, 'game')} with seeds {seeds[0]} to {seeds[-1]}, in {settings.to}")
    if kept := settings.games - sum(map(len, blocks)):
        print(f"{kept} of them {'is' if kept == 1 else 'are'} there already and {'is' if kept == 1 else 'are'} kept")
    _play_blocks(settings, trajectories, [[seed - settings.seed + 1 for seed in block] for block in blocks], held.damaged)
    after = find_collection(settings.to, identity_of(settings, trajectories), partial(seeds_from, playable=playable))
    if lost := len(set(seeds) - after.seeds):
        raise ImpossibleCollection(
            f"{settings.to} lacks {counted(lost, 'game')} that {'was' if lost == 1 else 'were'} played: something removed logs "
            "meanwhile; run it again"
        )
    return 0


def check(settings: CollectSettings) -> None:
    """Check settings.

    Raises:
        ImpossibleCollection: nothing can be collected so.
    """
    if settings.hider not in HIDERS:
        raise ImpossibleCollection(f"there is no hider `{printable(settings.hider)}`; the table has {', '.join(HIDERS)}")
    if settings.games < 1 or settings.seed < 0 or settings.seed + settings.games - 1 > LARGEST_SEED:
        raise ImpossibleCollection(
            f"--games must be at least 1 and seeds lie in 0 .. {LARGEST_SEED:,}: choose another --games or --seed"
        )
    if settings.block < 1:
        raise ImpossibleCollection("--block must be at least 1")
    if settings.workers < 0:
        raise ImpossibleCollection("--workers must be at least 1, or 0 for one for each core")
    try:
        msgspec.convert(msgspec.to_builtins(settings.rules), Rules)
    except ValueError as error:
        where = str(error)
        for name in Rules.__struct_fields__:
            where = where.replace(name, option_of(f"rules.{name}"))
        raise ImpossibleCollection(f"no game has such rules: {where.replace('$.', '')}") from None
    try:
        make_layout(settings.layout, settings.seed)
    except ImpossibleLayout as error:
        raise ImpossibleCollection(str(error)) from None


def _trajectories_for(settings: CollectSettings) -> TrajectoriesBySplit:
    """Read what `--hider replay` plays, and print what that is."""
    if settings.source is None:
        raise ImpossibleCollection("`--hider replay` needs the recorded trajectories: --from FOLDER")
    found = read_trajectories(settings.source, settings.driver)
    for line in found.breaks:
        print(line)
    if not any(found.by_split):
        wanted = f" that `{printable(settings.driver)}` drove" if settings.driver else ""
        raise ImpossibleCollection(f"{settings.source} holds no hider trajectory{wanted}: {found}")
    print(f"{settings.source}: {found}")
    if lacking := [name for name, of_split in zip(SPLITS, found.by_split, strict=True) if not of_split]:
        print(
            f"seeds of the splits {', '.join(lacking)} are left out, for which nothing was recorded: a game replays only what "
            "was recorded in its own split, so that no path is in training and in test"
        )
    return found.by_split


def seeds_from(first: int, games: int, playable: frozenset[int] = EVERY_SPLIT) -> list[int]:
    """Return the seeds of games from the first one on, without those of splits that are not playable."""
    return list(islice((seed for seed in count(first) if split_of(seed) in playable), games))


def logs_of(settings: CollectSettings) -> list[Path]:
    """Return the logs that a collection consists of that is made in one go and leaves no split out."""
    return [log_path(settings, first) for first in range(settings.seed, settings.seed + settings.games, settings.block)]


def log_path(settings: CollectSettings, seed: int) -> Path:
    """Return the log whose first game has this seed."""
    return settings.to / f"{settings.hider}_{settings.seeker}_{seed:07d}.mcap"


def identity_of(settings: CollectSettings, trajectories: TrajectoriesBySplit = NO_TRAJECTORIES) -> dict[str, Any]:
    """Return what decides what is in the logs of a collection: nothing that depends on where or when they are made."""
    return {
        "settings": {
            "hider": settings.hider,
            "seeker": settings.seeker,
            "seed": settings.seed,
            "block": settings.block,
            "views": settings.views,
            "rules": msgspec.to_builtins(settings.rules),
            "world": plain(settings.world),
        },
        "trajectories": trajectories_hash(trajectories),
    }


def play_block(
    settings: CollectSettings,
    block: Sequence[int],
    path: Path,
    trajectories: TrajectoriesBySplit = NO_TRAJECTORIES,
    replace_log: bool = False,
) -> int:
    """Play a block of games into one log. Returns the number of steps played.

    Args:
        block: numbers of the games, ascending; game 1 has the seed of the settings.
        replace_log: replace the log if there is one.

    Raises:
        AlreadyExists: see `replace_log`.
        OSError: of the disk; no log is left then.
    """

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
    seeds = stretches(settings.seed + number - 1 for number in block)
    cores: dict[str, Core] = {
        "simulator": SimulatorCore(settings.world),
        "seeker": SeekerCore(SeekerSettings(publish_view=settings.views)),
        "hider": HiderCore(make_policy, publish_view=settings.views),
        "referee": RefereeOfStretches(
            [replace(referee, games=len(stretch), seed=stretch[0], first_episode=stretch[0]) for stretch in seeds]
        ),
    }
    configuration = {**identity_of(settings, trajectories), "games": len(block)}
    metadata = RunMetadata(commit=source_commit(), configuration=json.dumps(configuration), started=clock_of(first))
    with complete(path, replace=replace_log) as unfinished:
        # No flush by the wall clock: chunks, and so the file's bytes, depend on the messages alone.
        with LogWriter(unfinished, metadata, compression="lz4", sync=False, flush_period=2**62) as writer:
            return play(cores, len(block), clock_of(first), writer)


def _play(settings: CollectSettings, trajectories: TrajectoriesBySplit, damaged: Sequence[Path], block: Sequence[int]) -> int:
    path = log_path(settings, settings.seed + block[0] - 1)
    return play_block(settings, block, path, trajectories, replace_log=path in damaged)


def _play_blocks(
    settings: CollectSettings, trajectories: TrajectoriesBySplit, blocks: Sequence[Sequence[int]], damaged: Sequence[Path]
) -> None:
    """Play blocks of games into their logs, and show how far that is."""
    workers = worker_count(settings.workers, len(blocks))
    started = time.monotonic()
    steps = games = 0
    columns = (TextColumn("collecting"), BarColumn(), MofNCompleteColumn(), TextColumn("games  {task.fields[rate]}"))
    try:
        with (
            Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=Console()) as progress,
            closing(results_of(partial(_play, settings, trajectories, damaged), blocks, workers)) as results,
        ):
            task = progress.add_task("collect", total=sum(map(len, blocks)), rate="")
            for block, stepped in results:
                games += len(blocks[block])
                steps += stepped
                progress.update(task, completed=games, rate=f"{steps / (time.monotonic() - started):,.0f} steps/s")
    finally:
        remove_abandoned(settings.to)  # what a worker left that was ended in the middle of a game
    elapsed = time.monotonic() - started
    rate = f"{steps / elapsed:,.0f} steps/s with {counted(workers, 'worker')}"
    print(f"{counted(games, 'game')}, {counted(steps, 'step')} in {elapsed:.1f} s: {rate}, in {settings.to}")
