"""A copy of a log with channels for Foxglove, Lichtblick and Rerun beside the originals, and a layout that shows them."""

from __future__ import annotations

from pathlib import Path

from schemas import TOPICS
from vantage.log.foxglove_layout import SUFFIX, as_json, layout_of
from vantage.log.games import GameOutline, time_span
from vantage.log.metadata import PART, VIEWER_PREFIX
from vantage.log.reader import Log, find_logs, open_log
from vantage.log.target import Progress, TargetExists, in_silence, whole
from vantage.log.viewer import Viewer, ViewerMessage
from vantage.log.writer import LogWriter


def export(source: Path, target: Path, viewer: Viewer) -> tuple[int, list[str]]:
    """Write a log, all its parts, into one file together with what viewers understand of it (topics `viewer/...`).

    Args:
        source: a log, or a folder with one log.
        target: the new file.
        viewer: what translates.

    Returns:
        (messages of the original copied, what could not be read).

    Raises:
        FileNotFoundError: no log there.
        TargetExists: the target exists.
        ValueError: the folder holds several logs.
        OSError: the disk.
    """
    with open_log(*only_log(source)) as log:
        return export_log(log, target, viewer), log.breaks


def only_log(source: Path) -> list[Path]:
    """Return the parts of the one log at `source`.

    Raises:
        FileNotFoundError: no log there.
        ValueError: the folder holds several logs.
    """
    logs = find_logs(source)
    if len(logs) > 1:
        names = ", ".join(parts[0].name for parts in logs[:5])
        raise ValueError(f"{source} holds {len(logs)} logs ({names}, ...): name one of them")
    return logs[0]


def layout_path(target: Path) -> Path:
    """Return where the layout lies that belongs to an exported file."""
    return target.with_suffix(SUFFIX)


def export_log(
    log: Log,
    target: Path,
    viewer: Viewer,
    *,
    game: GameOutline | None = None,
    force: bool = False,
    progress: Progress = in_silence,
) -> int:
    """Write an open log; see `export`. Returns how many messages of the original were copied.

    Args:
        game: only the time of this game.
    """
    layout = layout_path(target)
    if layout.exists() and not force:
        raise TargetExists(layout)
    metadata = {name: value for name, value in log.metadata.items() if name != PART}
    first, last = (game.first_time, game.last_time) if game else time_span(log)
    shown: set[str] = set()

    def translate(key: str, payload: bytes) -> list[ViewerMessage]:
        messages = viewer.translate(key, payload)
        shown.update(VIEWER_PREFIX + message.topic for message in messages)
        return messages

    count = 0
    with whole(target, force=force) as partial:
        with LogWriter(partial, metadata, viewer=translate) as writer:
            for record in log.records(after=first - 1 if game is not None else -1):
                if game is not None and record.log_time > last:
                    break
                count += 1
                if count % 256 == 0:
                    progress("writing", (record.log_time - first) / max(last - first, 1))
                writer.write(
                    record.key,
                    record.payload,
                    log_time=record.log_time,
                    publish_time=record.publish_time,
                    sequence=record.sequence,
                    publisher=record.publisher,
                    well_formed=record.well_formed or record.key not in TOPICS,
                )
                if writer.error is not None:
                    break
        if writer.error is not None:
            raise OSError(writer.error.replace(str(partial), str(target)))
        with whole(layout, force=force) as partial_layout:
            partial_layout.write_text(as_json(layout_of(shown)))
    progress("writing", 1.0)
    return count
