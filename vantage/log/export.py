"""A copy of a log with channels for Foxglove, Lichtblick and Rerun beside the originals, and a layout that shows them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from msgspec import structs

from schemas import TOPICS, Control, Episode, MalformedMessage, encode
from vantage.log.file import first_metadata
from vantage.log.foxglove_layout import SUFFIX, as_json, layout_of
from vantage.log.games import WORD_TOPICS
from vantage.log.metadata import EXPORTED, PART, VIEWER_PREFIX
from vantage.log.outline import GameOutline, time_span
from vantage.log.reader import Log, Record, open_log, parts_of
from vantage.log.target import Progress, in_silence, require_free, whole
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
        NoSuchLog: not one log is there.
        AlreadyExists: the target exists.
        OSError: the disk.
    """
    with open_log(*parts_of(source)) as log:
        return export_log(log, target, viewer), log.breaks


def layout_path(target: Path) -> Path:
    """Return where the layout lies that belongs to an exported file."""
    return target.with_suffix(SUFFIX)


def _is_copy(path: Path) -> bool:
    return path.is_file() and EXPORTED in first_metadata(path)


def _is_layout(path: Path) -> bool:
    try:
        return "configById" in json.loads(path.read_text())
    except (OSError, ValueError, TypeError):
        return False


def _records_of(log: Log, game: GameOutline) -> Iterator[Record]:
    """What was recorded in the time of a game, and that it was discarded afterwards."""
    for record in log.records(after=game.first_time - 1):
        if record.log_time > game.last_time:
            break
        yield record
    discarded_at = game.game.discarded_at
    if discarded_at is not None and discarded_at > game.last_time:
        yield next(log.records(("control",), after=discarded_at - 1))


def _without_person(record: Record) -> bytes | None:
    """Return the payload without the name of who played; None where it cannot be told whether one is in it."""
    if record.key not in WORD_TOPICS:
        return record.payload
    try:
        message = record.decode()
    except MalformedMessage:
        return None
    if not isinstance(message, Control | Episode) or not message.players.person:
        return record.payload
    return encode(structs.replace(message, players=structs.replace(message.players, person="")))


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

    The name of a person (`players.person`) is blanked; `episode` and `control` messages that do not decode are left out.

    Args:
        game: only the time of this game, and that it was discarded.
    """
    sources = [file.path for file in log.files]
    layout = layout_path(target)
    require_free(layout, force, _is_layout)
    metadata = {name: value for name, value in log.metadata.items() if name != PART} | {EXPORTED: "foxglove"}
    first, last = (game.first_time, game.last_time) if game else time_span(log)
    shown: set[str] = set()

    def translate(key: str, payload: bytes) -> list[ViewerMessage]:
        messages = viewer.translate(key, payload)
        shown.update(VIEWER_PREFIX + message.topic for message in messages)
        return messages

    def copied(writer: LogWriter, records: Iterable[Record]) -> int:
        count = 0
        for record in records:
            payload = _without_person(record)
            if payload is None:
                continue
            count += 1
            if count % 256 == 0:
                progress("writing", (record.log_time - first) / max(last - first, 1))
            writer.write(
                record.key,
                payload,
                log_time=record.log_time,
                publish_time=record.publish_time,
                sequence=record.sequence,
                publisher=record.publisher,
                well_formed=record.well_formed or record.key not in TOPICS,
            )
        return count

    with whole(target, force=force, is_ours=_is_copy, sources=sources) as partial:
        with LogWriter(partial, metadata, viewer=translate) as writer:
            count = copied(writer, log.records() if game is None else _records_of(log, game))
        with whole(layout, force=force, is_ours=_is_layout) as partial_layout:
            partial_layout.write_text(as_json(layout_of(shown, viewer.appearance)))
    progress("writing", 1.0)
    return count
