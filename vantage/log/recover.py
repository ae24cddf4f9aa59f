"""Rewriting a log that was cut short or damaged, so that every tool opens it."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import AttachmentIndex

from vantage.errors import UserError
from vantage.log.compression import Compression
from vantage.log.file import DAMAGE, LogFile, read_metadata
from vantage.log.part import ChunkLost, Part
from vantage.output import complete
from vantage.printable import counted

_CHUNK_SIZE = 1 << 20
_TIMES = struct.Struct("<QQ")
_LENGTH = struct.Struct("<I")
_DATA_LENGTH = struct.Struct("<Q")


class NothingToRecover(UserError):
    """A file is no log at all, so that nothing of it could be saved."""


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """The result of a recovery.

    Attributes:
        source, target: the files.
        messages, attachments: how many were saved.
        breaks: what could not be read, a line each; empty when the source was whole.
        finished: whether the source had been closed properly.
        recording: whether the source is being recorded now, so that it goes on beyond the copy.
        first_time, last_time: of the messages saved, ns since the Unix epoch; 0 when there is none.
    """

    source: Path
    target: Path
    messages: int
    attachments: int
    breaks: tuple[str, ...]
    finished: bool
    recording: bool
    first_time: int
    last_time: int

    def __str__(self) -> str:
        seconds = (self.last_time - self.first_time) / 1e9
        saved = counted(self.messages, "message") + f" over {seconds:.1f} s"
        if self.attachments:
            saved += " and " + counted(self.attachments, "attachment")
        text = f"{self.source} -> {self.target}: {saved} saved"
        if self.recording:
            return text + "; the log is being recorded now, and goes on"
        if not self.breaks and self.finished:
            return text + "; the log was whole"
        return text + "; " + "; ".join(self.breaks or ("the file had not been closed",))


def recover(source: Path, target: Path) -> RecoveryReport:
    """Write everything readable of one MCAP file into a new one.

    Kept are messages with their times and channels, schemas, the profile, all metadata, attachments and private records. The
    file gets its name when it is complete.

    Args:
        source: any MCAP file, also one of another program.
        target: the new file.

    Raises:
        NothingToRecover: the source is no MCAP file.
        AlreadyExists: the target exists.
        OSError: the source cannot be opened, or the target not be written.
    """
    file = LogFile(source)
    try:
        if not file.is_mcap:
            raise NothingToRecover(f"{source}: {'; '.join(file.breaks)}, so there is nothing to recover; name a log")
        with complete(target, replace=False) as partial:
            part = Part(partial, _CHUNK_SIZE, profile=file.profile, library=file.library or "vantage")
            try:
                part.open()
                attachments = _copy_extras(file, part)
                first, last = _copy_messages(file, part)
                part.finish()
                part.sync()
            except ChunkLost as lost:
                raise lost.error from None
            finally:
                part.close()
        breaks = tuple(file.breaks)
        return RecoveryReport(source, target, part.message_count, attachments, breaks, file.finished, file.recording, first, last)
    finally:
        file.close()


def _copy_extras(file: LogFile, part: Part) -> int:
    """Copy metadata, attachments and private records; return how many attachments there are."""
    attachments = 0
    for opcode, start, end in file.extras:
        content = file.content[start:end]
        if opcode == Opcode.METADATA:
            record = read_metadata(content)
            part.add_metadata(record.name, record.metadata)
        elif opcode == Opcode.ATTACHMENT:
            try:
                index = _attachment_index(content)
            except DAMAGE as error:
                file.breaks.append(f"damaged attachment at byte {start - 9}: {error}")
                continue
            part.write_attachment(index, memoryview(content))
            attachments += 1
        else:
            part.add_record(opcode, content)
    return attachments


def _attachment_index(content: bytes) -> AttachmentIndex:
    """Describe an attachment for the summary.

    Raises:
        ValueError and others: it is damaged.
    """
    log_time, create_time = _TIMES.unpack_from(content)
    position, names = _TIMES.size, []
    for _ in range(2):
        (length,) = _LENGTH.unpack_from(content, position)
        names.append(content[position + 4 : position + 4 + length].decode())
        position += 4 + length
    (size,) = _DATA_LENGTH.unpack_from(content, position)
    if position + 8 + size + 4 != len(content):
        raise ValueError("its length does not match")
    (crc,) = _LENGTH.unpack_from(content, len(content) - 4)
    if crc and crc != zlib.crc32(memoryview(content)[:-4]):
        raise ValueError("CRC does not match")
    return AttachmentIndex(0, 0, log_time, create_time, size, names[0], names[1])


def _copy_messages(file: LogFile, part: Part) -> tuple[int, int]:
    """Copy schemas, channels and messages; return the first and the last log time."""
    schemas = {0: 0}
    for schema in file.schemas.values():
        if schema.id:
            schemas[schema.id] = part.add_schema(schema.name, schema.encoding, schema.data)
    channels: dict[int, int] = {}
    for channel in file.channels.values():
        if channel.schema_id not in schemas:
            schemas[channel.schema_id] = part.add_schema("", "", b"")  # the file does not describe it
        schema_id = schemas[channel.schema_id]
        channels[channel.id] = part.add_channel(channel.topic, channel.message_encoding, schema_id, channel.metadata)
    unknown: set[int] = set()
    first, last = 2**64 - 1, 0
    for chunk in file.chunks:
        compression: Compression = "zstd" if chunk.compression == "zstd" else "lz4" if chunk.compression == "lz4" else "none"
        for id, sequence, log_time, publish_time, payload in file.messages_of(chunk):
            if id not in channels:
                unknown.add(id)
                continue
            if part.add_message(channels[id], compression, compression, sequence, log_time, publish_time, payload):
                part.write_chunk(compression)
            first, last = min(first, log_time), max(last, log_time)
    if unknown:
        file.breaks.append(f"messages of {counted(len(unknown), 'channel')} that the file does not describe")
    for group in part.groups:
        part.write_chunk(group)
    return (first, last) if last else (0, 0)
