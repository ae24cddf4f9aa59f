"""The `vantage log` commands: each a typed configuration and a function that returns an exit code."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.text import Text

from services.recorder.appearance import arena_appearance
from vantage.log.export_formats import export_to, shown_progress
from vantage.log.lerobot_features import Choice
from vantage.log.reader import find_logs
from vantage.log.recover import NothingToRecover
from vantage.log.recover import recover as rewrite
from vantage.log.report import info as describe
from vantage.printable import printable


class _Output(Console):
    """A console that leaves it to `vantage.cli` what becomes of a reader that goes away, as `head` does."""

    def on_broken_pipe(self) -> None:
        raise


console = _Output(highlight=False)
complaints = Console(highlight=False, stderr=True)

Source = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG")]


@dataclass(frozen=True)
class Info:
    """Say what is in a log: its making, topics with counts and rates, losses, games with their outcomes.

    Examples:
        vantage log info logs/
        vantage log info logs/table-20261122-031500.mcap
    """

    source: Source
    """A log (.mcap), or a folder of logs."""


@dataclass(frozen=True)
class Recover:
    """Rewrite a log that a crash cut short, so that every tool opens it.

    Examples:
        vantage log recover logs/broken.mcap --to whole.mcap
    """

    source: Source
    """The log, or a folder of logs."""
    to: Path | None = None
    """The new file, or for a folder the new folder; by default beside the source, named `*-recovered`."""


@dataclass(frozen=True)
class Export:
    """Write a log for other programs.

    foxglove: a copy with channels that Foxglove and Lichtblick show, and a layout file to import there. No format holds the
    name of a person who played (`players.person`); the log itself keeps it.
    rerun: a recording with a ready view, a game a file.
    lerobot: a data set for LeRobot (v3) of all finished games: lossless pictures, true times, what the hider can know. LOG may
    be a folder of logs.
    video: an MP4 of each game at true speed, for a browser.

    Examples:
        vantage log export logs/game.mcap
        vantage log export logs/game.mcap --as video --game 3
        vantage log export logs/ --as lerobot --to hide-and-seek
    """

    source: Source
    """The log: a file, the first part of several (NAME_000.mcap), or a folder with one log (for lerobot: with any number)."""
    as_: Annotated[Literal["foxglove", "rerun", "lerobot", "video"], tyro.conf.arg(name="as")] = "foxglove"
    """For which program."""
    to: Path | None = None
    """The new file, or folder (lerobot, and rerun or video of several games); by default beside the source."""
    game: int | None = None
    """Only the game of this number, see `vantage log info`."""
    force: bool = False
    """Replace an earlier export of that name; nothing else is ever replaced."""
    seeker_pictures: bool = False
    """lerobot: also what the seeker sees. The hider cannot know it, but LeRobot's policies take every picture as an input."""
    without_catching: bool = False
    """lerobot: also games without catching, which every hider survives."""
    rate: float | None = None
    """lerobot: only games of this rate, steps per second (0: as fast as the players answered); a data set has one rate."""


def info(settings: Info) -> int:
    """Print what is in the logs. Exit code 2 when something in them could not be read."""
    reports = describe(settings.source)
    for report in reports:
        console.print(report)
    return 2 if any(report.breaks for report in reports) else 0


def recover(settings: Recover) -> int:
    """Rewrite one file, or every file of a folder. Exit code 1 when one could not be rewritten at all."""
    source = settings.source
    if source.is_file():
        print_plain(str(rewrite(source, settings.to or source.with_name(f"{source.stem}-recovered.mcap"))))
        return 0
    folder = settings.to or source.with_name(f"{source.name}-recovered")
    failed = False
    for path in (path for parts in find_logs(source) for path in parts):
        target = folder / path.relative_to(source)
        if os.path.lexists(target):
            print_plain(f"{target} is there already, and was left as it is")
            continue
        try:
            print_plain(str(rewrite(path, target)))
        except NothingToRecover as error:
            print_plain(f"vantage log recover: {error}", complaints)
            failed = True
    return int(failed)


def export(settings: Export) -> int:
    """Export a log. Exit code 2 when something in the log could not be read."""
    with shown_progress(complaints) as progress:
        done = export_to(
            settings.as_,
            settings.source,
            settings.to,
            arena_appearance(),
            episode=settings.game,
            force=settings.force,
            progress=progress,
            choice=Choice(settings.seeker_pictures, settings.without_catching, settings.rate),
        )
    for text in done.said:
        print_plain(text)
    for text in done.breaks:
        print_plain(text, complaints, "yellow")
    return 2 if done.breaks else 0


def print_plain(text: str, to: Console = console, style: str = "") -> None:
    """Print a line that holds names from files, without what a terminal would obey."""
    to.print(Text(printable(text, 10_000), style), soft_wrap=True)
