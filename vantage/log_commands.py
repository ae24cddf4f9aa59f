"""The `vantage log` commands: each a typed configuration and a function that returns an exit code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.markup import escape

from services.recorder.appearance import arena_appearance
from vantage.log.export import export as translate
from vantage.log.reader import find_logs
from vantage.log.recover import recover as rewrite
from vantage.log.report import info as describe
from vantage.log.viewer import Viewer

console = Console(highlight=False)
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
    """Copy a log with channels that Foxglove, Lichtblick and Rerun show: pictures, poses, the scene, the value map, texts.

    Examples:
        vantage log export logs/game.mcap --to game-for-foxglove.mcap
    """

    source: Source
    """The log: a file, or a folder with the parts of one run."""
    to: Path | None = None
    """The new file; by default beside the source, named `*-viewer.mcap`."""


def info(settings: Info) -> int:
    """Print what is in the logs. Exit code 1 when none could be opened, 2 when something in them could not be read."""
    try:
        reports = describe(settings.source)
    except OSError as error:
        return _failed("info", error)
    for report in reports:
        console.print(report)
    return 2 if any(report.breaks for report in reports) else 0


def recover(settings: Recover) -> int:
    """Rewrite one file, or every file of a folder. Exit code 1 when one could not be rewritten at all."""
    source = settings.source
    try:
        if source.is_file():
            files = {source: settings.to or source.with_name(f"{source.stem}-recovered.mcap")}
        else:
            folder = settings.to or source.with_name(f"{source.name}-recovered")
            files = {path: folder / path.relative_to(source) for parts in find_logs(source) for path in parts}
        for path, target in files.items():
            target.parent.mkdir(parents=True, exist_ok=True)
            console.print(str(rewrite(path, target)), soft_wrap=True)
    except OSError as error:
        return _failed("recover", error)
    return 0


def export(settings: Export) -> int:
    """Export one log. Exit code 1 when it failed, 2 when something in the log could not be read."""
    target = settings.to or settings.source.with_name(f"{settings.source.stem}-viewer.mcap")
    try:
        count, breaks = translate(settings.source, target, Viewer(arena_appearance()))
    except (OSError, ValueError) as error:
        return _failed("export", error)
    console.print(f"{target}: {count} messages, and what Foxglove, Lichtblick and Rerun show of them", soft_wrap=True)
    for text in breaks:
        console.print(f"[yellow]{escape(text)}[/yellow]", soft_wrap=True)
    return 2 if breaks else 0


def _failed(command: str, error: Exception) -> int:
    if isinstance(error, FileExistsError):
        text = f"{error.filename} exists already: choose another name with --to"
    elif isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}"
    else:
        text = str(error)
    complaints.print(escape(f"vantage log {command}: {text}"), soft_wrap=True)
    return 1
