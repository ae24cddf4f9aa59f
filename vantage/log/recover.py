"""Rewriting a log that was cut short or damaged, so that every tool opens it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mcap.records import Schema

from vantage.log.file import LogFile
from vantage.log.part import Compression, Part

_CHUNK_SIZE = 1 << 20


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """What came out of a recovery.

    Attributes:
        source, target: the files.
        messages: how many were saved.
        breaks: what could not be read, a line each; empty when the source was whole.
        finished: whether the source had been closed properly.
        first_time, last_time: of the messages saved, ns since the Unix epoch; 0 when there is none.
    """

    source: Path
    target: Path
    messages: int
    breaks: tuple[str, ...]
    finished: bool
    first_time: int
    last_time: int

    def __str__(self) -> str:
        seconds = (self.last_time - self.first_time) / 1e9
        text = f"{self.source} -> {self.target}: {self.messages} messages over {seconds:.1f} s saved"
        if not self.breaks and self.finished:
            return text + "; the log was whole"
        return text + "; " + "; ".join(self.breaks or ("the file had not been closed",))


def recover(source: Path, target: Path) -> RecoveryReport:
    """Write everything readable of one MCAP file into a new one, message for message: channels, schemas, metadata, times.

    Args:
        source: any MCAP file, also one of another program (attachments are not kept).
        target: the new file.

    Raises:
        OSError: the source cannot be opened, or the target not be written.
        FileExistsError: the target exists.
    """
    file = LogFile(source)
    try:
        part = Part(target, _CHUNK_SIZE)
        try:
            first, last = _copy(file, part)
            part.finish()
            part.sync()
        finally:
            part.close()
        return RecoveryReport(source, target, part.message_count, tuple(file.breaks), file.finished, first, last)
    finally:
        file.close()


def _copy(file: LogFile, part: Part) -> tuple[int, int]:
    for name, metadata in file.metadata.items():
        part.add_metadata(name, metadata)
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    unknown: set[int] = set()
    first, last = 2**64 - 1, 0
    for chunk in file.chunks:
        compression: Compression = "zstd" if chunk.compression == "zstd" else "lz4" if chunk.compression == "lz4" else "none"
        for channel_id, sequence, log_time, publish_time, payload in file.messages_of(chunk):
            channel = channels.get(channel_id)
            if channel is None:
                known = file.channels.get(channel_id)
                if known is None:
                    unknown.add(channel_id)
                    continue
                if known.schema_id not in schemas:
                    schema = file.schemas.get(known.schema_id) or Schema(known.schema_id, b"", "", "")
                    schemas[known.schema_id] = part.add_schema(schema.name, schema.encoding, schema.data)
                channel = part.add_channel(known.topic, known.message_encoding, schemas[known.schema_id], known.metadata)
                channels[channel_id] = channel
            if part.add_message(channel, compression, compression, sequence, log_time, publish_time, payload):
                part.write_chunk(compression)
            first, last = min(first, log_time), max(last, log_time)
    if unknown:
        file.breaks.append(f"messages of {len(unknown)} channels that the file does not describe")
    for group in part.groups:
        part.write_chunk(group)
    return (first, last) if last else (0, 0)
