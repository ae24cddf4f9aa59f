"""Hider trajectories in logs: what a human, a scripted evader or a planner really did, to be replayed from other starts."""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from learning.hiders.replay import Trajectories
from learning.splits import SPLITS, split_of
from schemas import PRIMITIVES
from vantage.log import find_logs, open_log
from vantage.log.episodes import EpisodeLog, games_of
from vantage.log.games import unfinished
from vantage.printable import printable
from vantage.world.arena import STAY

TrajectoriesBySplit = tuple[Trajectories, Trajectories, Trajectories]
NO_TRAJECTORIES: TrajectoriesBySplit = ((), (), ())

TOPICS = frozenset({"episode", "tick", "control", "gap", "hider/command", "hider/pose", "seeker/pose"})
_NUMBER = {name: number for number, name in enumerate(PRIMITIVES)}


@dataclass
class Recorded:
    """What logs hold.

    Attributes:
        by_split: trajectories (int64 [steps] of primitives each), by the split of the game they were recorded in.
        drivers: who drove the hider (`players.hider`) -> how many trajectories.
        left_out: reason -> how many games.
        breaks: what could not be read of them, a line each.
    """

    by_split: TrajectoriesBySplit = NO_TRAJECTORIES
    drivers: Counter[str] = field(default_factory=Counter)
    left_out: Counter[str] = field(default_factory=Counter)
    breaks: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        """Return how many trajectories there are of whom, in one line."""
        by_split = ", ".join(f"{len(found)} {split}" for split, found in zip(SPLITS, self.by_split, strict=True))
        drivers = ", ".join(f"{count} of {printable(driver)}" for driver, count in sorted(self.drivers.items()))
        left_out = ", ".join(f"{count} {printable(reason)}" for reason, count in sorted(self.left_out.items()))
        total = self.drivers.total()
        found = f"{total} {'trajectory' if total == 1 else 'trajectories'}, {drivers} ({by_split})" if total else "no trajectory"
        return f"{found}; left out: {left_out}" if left_out else found


def trajectories_hash(trajectories: TrajectoriesBySplit) -> str:
    """Return a hash of what `--hider replay` may play; empty when there is nothing."""
    digest = hashlib.sha256()
    for split in trajectories:
        for primitives in split:
            digest.update(len(primitives).to_bytes(8, "little") + primitives.tobytes())
        digest.update(b"split")
    return digest.hexdigest() if any(trajectories) else ""


def read_trajectories(source: Path, driver: str | None = None) -> Recorded:
    """Return the hider trajectories of the games in logs.

    Args:
        source: a log, or a folder with logs.
        driver: only games whose hider this one drove (`human`, `planner`, `scripted-1`, ...); None = all.

    Raises:
        NoSuchLog: there is none.
    """
    found: tuple[list[NDArray[np.int64]], ...] = ([], [], [])
    recorded = Recorded()
    for parts in find_logs(source):
        with open_log(*parts) as log:
            for game in games_of(log, TOPICS):
                hider = game.episode.players.hider
                primitives = executed_primitives(game)
                reason = f"driven by {hider}" if driver not in (None, hider) else _unusable(game, primitives)
                if reason or primitives is None:
                    recorded.left_out[reason] += 1
                    continue
                recorded.drivers[hider] += 1
                found[split_of(game.episode.seed)].append(primitives)
            recorded.breaks += [f"{printable(text)}: only what is whole is replayed" for text in log.breaks]
    train, validation, test = (tuple(trajectories) for trajectories in found)
    recorded.by_split = train, validation, test
    return recorded


def executed_primitives(game: EpisodeLog) -> NDArray[np.int64] | None:
    """Return what the hider really did, int64 [steps]: where its command came late it stayed. None where a command is missing."""
    primitives = np.full(game.steps, STAY, np.int64)
    for step in range(game.steps):
        if "hider" in game.late.get(step, ()):
            continue
        command = game.commands["hider"].get(step)
        if command is None:
            return None
        primitives[step] = _NUMBER[command.primitive]
    return primitives


def _unusable(game: EpisodeLog, primitives: NDArray[np.int64] | None) -> str:
    """Return why a game's trajectory is not to be replayed, or nothing."""
    if reason := unfinished(game):
        return reason
    # A recorder that was started again hears the last words on earlier games, but not how they went.
    return "not recorded whole" if primitives is None or game.steps < game.episode.step else ""
