"""The formats that a log is exported to: which files come out, of which games, and what is said about it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from vantage.log.appearance import Appearance
from vantage.log.export import export_log, layout_path, only_log
from vantage.log.games import GameOutline, outline
from vantage.log.reader import Log, find_logs, open_log
from vantage.log.target import ExportError, Progress, in_silence
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
) -> Done:
    """Export the log at `source`.

    Args:
        output: the new file or folder; None: beside the source.
        looks: what things look like.
        episode: only this game.
        force: replace an earlier export.

    Raises:
        ExportError: it cannot be done; the text says why.
        ValueError: several logs where one is wanted.
        OSError: the disk, or there is no log.
    """
    source = Path(source)
    stem = source.stem if source.suffix == ".mcap" else source.name or source.resolve().name
    if format == "lerobot":
        return _to_lerobot(source, output or source.with_name(f"{stem}-lerobot"), looks, episode, force, progress)
    with open_log(*only_log(source)) as log:
        games = outline(log, progress) if format != "foxglove" or episode is not None else []
        if episode is not None:
            games = [_game(games, episode)]
        if format == "foxglove":
            target = output or source.with_name(f"{stem}-viewer.mcap")
            count = export_log(log, target, Viewer(looks), game=games[0] if games else None, force=force, progress=progress)
            done = Done([f"{target}: {count} messages, and what Foxglove, Lichtblick and Rerun show of them"])
            done.said.append(f"{layout_path(target)}: a layout; import it in Foxglove or Lichtblick")
        else:
            done = _by_game(format, log, games, stem, source, output, looks, force, progress)
        done.breaks += log.breaks
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


def _game(games: list[GameOutline], episode: int) -> GameOutline:
    chosen = [game for game in games if game.number == episode]
    if not chosen:
        numbers = ", ".join(str(game.number) for game in games[:20]) + (", ..." if len(games) > 20 else "")
        raise ExportError(f"there is no game {episode} in this log; there is: {numbers or 'none'}")
    return chosen[-1]


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
        from vantage.log.rerun_recording import write_recording as write
    else:
        from vantage.log.video import write_video as write
    ending = ENDINGS[format]
    if len(games) == 1:
        targets = [output or source.with_name(stem + ending)]
    else:
        folder = output or source.with_name(f"{stem}-{format}")
        targets = [folder / f"game-{game.number:04d}{ending}" for game in games]
        if len(set(targets)) < len(targets):
            targets = [folder / f"game-{game.number:04d}-seed-{game.episode.seed}{ending}" for game in games]
    done = Done()
    for number, (game, target) in enumerate(zip(games, targets, strict=True)):
        share = f"game {game.number}: " if len(games) > 1 else ""

        def told(what: str, part: float, share: str = share, number: int = number) -> None:
            progress(share + what, (number + part) / len(games))

        done.said.append(f"{target}: {write(log, game, target, looks, force=force, progress=told)}")
    return done


def _to_lerobot(source: Path, target: Path, looks: Appearance, episode: int | None, force: bool, progress: Progress) -> Done:
    from vantage.log.lerobot_export import write_dataset

    done = Done()
    logs = find_logs(source)
    if episode is not None:
        only_log(source)
    summary = write_dataset(logs, target, looks, episode=episode, force=force, progress=progress)
    done.said.append(f"{target}: {summary.episodes} episodes, {summary.frames} frames")
    done.said += summary.left_out
    done.breaks += summary.breaks
    return done
