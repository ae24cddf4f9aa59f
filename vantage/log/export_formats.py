"""The formats that a log is exported to: which files come out, of which games, and what is said about it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from vantage.log.appearance import Appearance
from vantage.log.export import export_log, layout_path
from vantage.log.games import find_game
from vantage.log.lerobot_features import Choice
from vantage.log.outline import GameOutline, called, outline, time_span
from vantage.log.reader import Log, find_logs, open_log, parts_of
from vantage.log.target import ExportError, Progress, in_silence, require_free
from vantage.log.viewer import Viewer

Format = Literal["foxglove", "rerun", "lerobot", "video"]

ENDINGS = {"rerun": ".rrd", "video": ".mp4"}


@dataclass
class Done:
    """What an export came to.

    Attributes:
        said: lines for people: the files, and what is in them.
        breaks: what could not be read.
    """

    said: list[str] = field(default_factory=list)
    breaks: list[str] = field(default_factory=list)


def export_to(
    format: Format,
    source: Path,
    output: Path | None,
    looks: Appearance,
    *,
    episode: int | None = None,
    force: bool = False,
    progress: Progress = in_silence,
    choice: Choice | None = None,
) -> Done:
    """Export the log at `source`.

    Args:
        output: the new file or folder; None: beside the source.
        looks: what things look like.
        episode: only this game.
        force: replace an earlier export.
        choice: of what comes into a data set.

    Raises:
        ExportError, NoSuchGame, NoSuchLog: it cannot be done; the text says why.
        OSError: the disk, or there is no log.
    """
    choice = choice or Choice()
    source = Path(source)
    if source.name in ("", ".."):
        source = source.resolve()
    if not source.name:
        raise ExportError(f"{source} has no name that an export could have: name the log")
    stem = source.stem if source.suffix == ".mcap" else source.name
    if format == "lerobot":
        return _to_lerobot(source, output or source.with_name(f"{stem}-lerobot"), looks, episode, force, progress, choice)
    with open_log(*parts_of(source)) as log:
        _require_messages(source, log)
        games = outline(log, progress) if format != "foxglove" or episode is not None else []
        if episode is not None:
            games = [find_game(games, episode)]
        if format == "foxglove":
            target = output or source.with_name(f"{stem}-viewer.mcap")
            game = games[0] if games else None
            count = export_log(log, target, Viewer(looks), game=game, force=force, progress=progress)
            which = "" if game is None else f"{called(game)}: "
            done = Done([f"{target}: {which}{count} messages, and what Foxglove, Lichtblick and Rerun show of them"])
            done.said.append(f"{layout_path(target)}: a layout; import it in Foxglove or Lichtblick")
        else:
            done = _by_game(format, log, games, stem, source, output, looks, force, progress)
        done.breaks += log.breaks
        if log.recording:
            done.said.append(f"{source} is being recorded now: the export ends where the log did")
        return done


@contextmanager
def shown_progress(console: Console) -> Iterator[Progress]:
    """Yield a progress that is shown as a bar, on a terminal."""
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("reading", total=1.0)

        def progress(what: str, part: float) -> None:
            bar.update(task, description=what, completed=part)

        yield progress


def _require_messages(source: Path, log: Log) -> None:
    if time_span(log) == (0, 0):
        why = "; ".join(log.breaks) or "it holds none"
        raise ExportError(f"{source}: no message can be read from it: {why}")


def file_names(games: Sequence[GameOutline]) -> list[str]:
    """Return a name for each game that no other has: by number, where that comes again by seed, too, else also by turn."""
    numbers = Counter(game.number for game in games)
    seeds = Counter((game.number, game.episode.seed) for game in games)
    turns: Counter[tuple[int, int]] = Counter()
    names = []
    for game in games:
        known = game.number, game.episode.seed
        turns[known] += 1
        name = f"game-{game.number:04d}"
        if numbers[game.number] > 1:
            name += f"-seed-{game.episode.seed}"
        if seeds[known] > 1:
            name += f"-{turns[known]}"
        names.append(name)
    return names


def _by_game(
    format: Format,
    log: Log,
    games: list[GameOutline],
    stem: str,
    source: Path,
    output: Path | None,
    looks: Appearance,
    force: bool,
    progress: Progress,
) -> Done:
    games = [game for game in games if game.held.get("hider/pose") or game.held.get("seeker/pose")]
    if not games:
        raise ExportError("this log holds no game with a pose in it, so there is nothing to show")
    write: Callable[..., str]
    if format == "rerun":
        from vantage.log.rerun_recording import is_recording as is_ours
        from vantage.log.rerun_recording import write_recording as write
    else:
        from vantage.log.video import is_video as is_ours
        from vantage.log.video import write_video as write
    ending = ENDINGS[format]
    if len(games) == 1:
        targets = [output or source.with_name(stem + ending)]
    else:
        folder = output or source.with_name(f"{stem}-{format}")
        targets = [folder / f"{name}{ending}" for name in file_names(games)]
    for target in targets:
        require_free(target, force, is_ours, [file.path for file in log.files])
    done = Done()
    for number, (game, target) in enumerate(zip(games, targets, strict=True)):
        share = f"game {game.number}: " if len(games) > 1 else ""

        def told(what: str, part: float, share: str = share, number: int = number) -> None:
            progress(share + what, (number + part) / len(games))

        done.said.append(f"{target}: {write(log, game, target, looks, force=force, progress=told)}")
    return done


def _to_lerobot(
    source: Path,
    target: Path,
    looks: Appearance,
    episode: int | None,
    force: bool,
    progress: Progress,
    choice: Choice,
) -> Done:
    from vantage.log.lerobot_export import write_dataset

    done = Done()
    logs = find_logs(source) if source.is_dir() and episode is None else [parts_of(source)]
    if len(logs) == 1:
        with open_log(*logs[0]) as log:
            _require_messages(source, log)
    summary = write_dataset(logs, target, looks, episode=episode, force=force, progress=progress, choice=choice)
    done.said.append(f"{target}: {summary.episodes} {'game' if summary.episodes == 1 else 'games'}, {summary.frames} frames")
    done.said += summary.left_out
    done.breaks += summary.breaks
    return done
