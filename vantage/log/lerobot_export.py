"""Logs as a LeRobot v3 data set, written directly: Parquet files with PNGs, a game an episode.

Two passes over each log: the first says which games are whole, so that nothing has to be taken back; the second writes their
steps as they come. The folder gets its name when everything is in it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from schemas import ROBOTS
from vantage.log import lerobot_features as form
from vantage.log.appearance import Appearance
from vantage.log.games import find_game, unusable
from vantage.log.lerobot_writer import DatasetWriter
from vantage.log.outline import GameOutline, outline, steps_of
from vantage.log.reader import Log, open_log
from vantage.log.target import ExportError, Progress, in_silence, optional, whole
from vantage.printable import counted

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
    choice: form.Choice = form.PLAIN,
) -> DatasetSummary:
    """Write the finished games of logs as a LeRobot data set.

    Args:
        logs: each as its parts.
        target: the new folder.
        episode: only the game of this number.
        choice: what comes in.

    Raises:
        NoSuchGame: there is no game of that number, or several.
        ExportError: nothing to write, or pictures of several sizes or games of several rates; the text says what to do.
        OSError: the disk.
    """
    optional("pyarrow", "pyarrow")
    summary = DatasetSummary()
    chosen: list[tuple[Sequence[Path], list[GameOutline]]] = []
    reasons: dict[str, list[str]] = {}
    sources = [path for parts in logs for path in parts]
    with whole(target, force=force, is_ours=is_dataset, sources=sources) as folder:
        for number, parts in enumerate(logs):
            with open_log(*parts) as log:
                games = outline(log, _part_of(progress, number, 2 * len(logs)))
                summary.breaks += log.breaks
            good = []
            for game in games if episode is None else [find_game(games, episode)]:
                reason = why_left_out(game, choice)
                if reason:
                    reasons.setdefault(reason, []).append(
                        f"{game.number}" if len(logs) == 1 else f"{parts[0].stem}:{game.number}"
                    )
                else:
                    good.append(game)
            chosen.append((parts, good))
        require_one_rate([(parts[0].stem, game) for parts, good in chosen for game in good], len(logs))
        summary.left_out = [_line(reason, games) for reason, games in reasons.items()]
        if not any(good for _, good in chosen):
            raise ExportError("; ".join(["no finished game to export", *summary.left_out]))
        views = all(game.has(key, game.steps) for _, good in chosen for game in good for key in _views_of(choice))
        if not views:
            summary.left_out.append("left out: state images, which not all games have")
        writer = DatasetWriter(folder, looks, views, choice)
        try:
            for number, (parts, good) in enumerate(chosen):
                with open_log(*parts) as log:
                    _write_games(log, parts, good, writer, _part_of(progress, len(logs) + number, 2 * len(logs)))
        finally:
            writer.close()
        writer.write_meta()
    summary.episodes, summary.frames = writer.episodes, writer.frames
    return summary


def why_left_out(game: GameOutline, choice: form.Choice) -> str:
    """Return why a game is not in a data set; empty when it is."""
    reason = unusable(game)
    if reason:
        return reason
    if not game.episode.rules.catching and not choice.without_catching:
        return "without catching, see --without-catching"
    if choice.rate is not None and abs(rate_of(game) - choice.rate) > 0.01 * choice.rate:
        return f"of another rate than {choice.rate:g} Hz"
    if game.steps == 0:
        return "over before the first step"
    for robot in ROBOTS:
        if not all(game.has_step(f"{robot}/command", step) or game.stayed(robot, step) for step in range(game.steps)):
            return "with messages missing"
    return ""


def rate_of(game: GameOutline) -> float:
    """Return the steps per second of a game; 0 where it was played as fast as the players answered."""
    period = game.episode.rules.step_period
    return 1 / period if period else 0.0


def require_one_rate(games: Sequence[tuple[str, GameOutline]], logs: int) -> None:
    """Check that games have one rate, as a LeRobot data set does.

    Args:
        games: (name of the log, game).
        logs: how many there are; with one, its name is left out.

    Raises:
        ExportError: they have several; the text names the games of each.
    """
    by_rate: dict[float, list[str]] = {}
    for log, game in games:
        by_rate.setdefault(round(rate_of(game), 3), []).append(f"{game.number}" if logs == 1 else f"{log}:{game.number}")
    if len(by_rate) > 1:
        found = "; ".join(f"{rate:g} Hz: {_some(names)}" for rate, names in sorted(by_rate.items()))
        raise ExportError(f"the games have several rates, and a data set has one ({found}): choose with --rate, or one --game")


def _views_of(choice: form.Choice) -> list[str]:
    return [f"{robot}/view" for robot in form.picture_robots(choice)]


def is_dataset(folder: Path) -> bool:
    """Whether a folder is a LeRobot data set that we wrote, and nobody else."""
    try:
        said = json.loads((folder / "meta" / "info.json").read_text())
    except (OSError, ValueError):
        return False
    return isinstance(said, dict) and said.get("robot_type") == form.ROBOT_TYPE


def _line(reason: str, games: list[str]) -> str:
    return f"left out: {counted(len(games), 'game')} {reason} ({_some(games)})"


def _some(games: list[str]) -> str:
    return ", ".join(games[:10]) + (", ..." if len(games) > 10 else "")


def _part_of(progress: Progress, number: int, count: int) -> Progress:
    return lambda what, part: progress(what, (number + part) / count)


def _write_games(log: Log, parts: Sequence[Path], games: list[GameOutline], writer: DatasetWriter, progress: Progress) -> None:
    keys = _KEYS + (_VIEWS if writer.views else ())
    for game, step, messages in steps_of(log, games, keys, progress):
        if step < game.steps:
            writer.add(game, step, messages)
        if step == game.steps - 1:
            writer.end_episode(game, parts[0].name)
