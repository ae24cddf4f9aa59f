"""A copy of a log with channels for Foxglove, Lichtblick and Rerun beside the originals."""

from __future__ import annotations

from pathlib import Path

from schemas import TOPICS
from vantage.log.metadata import PART
from vantage.log.reader import find_logs, open_log
from vantage.log.viewer import Viewer
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
        FileExistsError: the target exists.
        ValueError: the folder holds several logs.
        OSError: the disk.
    """
    logs = find_logs(source)
    if len(logs) > 1:
        names = ", ".join(parts[0].name for parts in logs[:5])
        raise ValueError(f"{source} holds {len(logs)} logs ({names}, ...): name one of them")
    with open_log(*logs[0]) as log:
        metadata = {name: value for name, value in log.metadata.items() if name != PART}
        with LogWriter(target, metadata, viewer=viewer.translate) as writer:
            count = 0
            for record in log.records():
                count += 1
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
            raise OSError(writer.error)
        return count, log.breaks
