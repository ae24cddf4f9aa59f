"""One MCAP file being written: chunks, indexes and summary, with nothing half-written left behind after an error.

The `mcap` package's own Writer keeps one compression for a whole file, cannot take a failed write back, and packs each message
through several small objects. This one uses `mcap`'s record classes for everything rare and packs messages itself. Its files
are checked with `mcap`'s readers in the test suite.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import struct
import time
import zlib
from pathlib import Path
from typing import Literal

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from vantage.log.chunk import OpenChunk
from vantage.log.compression import Compression
from vantage.log.metadata import REPEATED

FILE_MODE = 0o640
FOLDER_MODE = 0o750
"""Logs may hold the names of people who played: others on the machine do not read them. The umask narrows both further."""

_RECORD_HEAD = struct.Struct("<BQ")

_LOCK_TRIES = 100


class ChunkLost(Exception):
    """A chunk could not be written.

    Attributes:
        error: why.
        dropped: (topic, publisher) -> messages that are gone.
    """

    def __init__(self, error: OSError, dropped: dict[tuple[str, str], int]) -> None:
        super().__init__(f"{error}: {sum(dropped.values())} messages dropped")
        self.error = error
        self.dropped = dropped


class Part:
    """An MCAP file being written.

    Messages wait in chunks, one open chunk for each `group` (bulky streams apart from small messages, each with its own
    compression); `write_chunks` puts them into the file. What is in the file is always whole records: a failed write is
    taken back before the error is raised.
    """

    def __init__(
        self,
        path: Path,
        chunk_size: int,
        *,
        profile: str = "",
        library: str = "vantage",
        mode: int = FILE_MODE,
        durable: bool = False,
    ) -> None:
        """Prepare a part; `open` creates its file.

        Args:
            profile, library: of the header.
            mode: of the file, which the umask narrows further.
            durable: flush the file's name to the disk when it is created: else a power cut may take it, and so all of the file.
        """
        self.path = path
        self.size = 0
        self.message_count = 0
        self.chunk_count = 0
        self._mode = mode
        self._durable = durable
        self._chunk_size = chunk_size
        self._chunks: dict[str, OpenChunk] = {}
        self._waiting = RecordBuilder()
        self._waiting_metadata: list[tuple[int, int, str]] = []
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        # As bytes, because it grows as long as the part does: an object for each chunk is ten times larger.
        self._chunk_indexes = RecordBuilder()
        self._metadata_indexes: list[MetadataIndex] = []
        self._attachment_indexes: list[AttachmentIndex] = []
        self._counts: dict[int, int] = {}
        self._start = 2**64 - 1
        self._end = 0
        self._file: int | None = None
        self._waiting.write(MCAP0_MAGIC)
        Header(profile=profile, library=library).write(self._waiting)

    @property
    def is_open(self) -> bool:
        """Whether the file has been created."""
        return self._file is not None

    def open(self) -> None:
        """Create the file, with all that waits; nothing happens when there is one.

        The file is locked (flock) until it is closed: readers see that it is being written.

        Raises:
            FileExistsError: a log is never overwritten.
            OSError: the file cannot be created or its first bytes not be written; then there is none.
        """
        if self._file is not None:
            return
        self._file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, self._mode)
        try:
            _lock(self._file)
            if self._durable:
                _sync_folder(self.path.parent)
            self._write_waiting()
        except BaseException:
            os.close(self._file)
            self._file, self.size = None, 0
            os.unlink(self.path)
            raise

    @property
    def displaced(self) -> Literal["", "deleted", "moved"]:
        """What became of the file's name behind our back: empty while it still means this file."""
        if self._file is None:
            return ""
        held = os.fstat(self._file)
        try:
            named = os.stat(self.path)
        except (FileNotFoundError, NotADirectoryError):
            pass
        except OSError:
            return ""  # a folder that may not be looked into says nothing
        else:
            if (named.st_dev, named.st_ino) == (held.st_dev, held.st_ino):
                return ""
        return "moved" if held.st_nlink else "deleted"

    @property
    def counts(self) -> dict[tuple[str, str], int]:
        """(topic, publisher) -> messages in the file."""
        return self._named(self._counts)

    @property
    def pending(self) -> int:
        """Bytes of messages that are not in the file yet."""
        return sum(chunk.size for chunk in self._chunks.values())

    @property
    def groups(self) -> list[str]:
        """The groups that have had messages."""
        return list(self._chunks)

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Return the id of a new schema."""
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._schemas.append(schema)
        schema.write(self._waiting)
        return schema.id

    def add_channel(self, topic: str, encoding: str, schema: int, metadata: dict[str, str]) -> int:
        """Return the id of a new channel; `schema` 0 = none."""
        channel = Channel(id=len(self._channels) + 1, topic=topic, message_encoding=encoding, metadata=metadata, schema_id=schema)
        self._channels.append(channel)
        channel.write(self._waiting)
        return channel.id

    def add_metadata(self, name: str, metadata: dict[str, str]) -> None:
        """Add a metadata record in front of the next chunk."""
        before = self._waiting.count
        Metadata(name=name, metadata=metadata).write(self._waiting)
        self._waiting_metadata.append((before, self._waiting.count - before, name))

    def add_message(
        self, channel: int, group: str, compression: Compression, sequence: int, log_time: int, publish_time: int, payload: bytes
    ) -> bool:
        """Add a message to the open chunk of `group`; return whether that chunk is full and wants `write_chunk`."""
        chunk = self._chunks.get(group)
        if chunk is None:
            chunk = self._chunks[group] = OpenChunk(compression)
        chunk.add(channel, sequence, log_time, publish_time, payload)
        return chunk.size >= self._chunk_size

    def write_chunk(self, group: str) -> bool:
        """Write the open chunk of `group` into the file; return whether there was anything in it.

        Raises:
            ChunkLost: the file could not be written; the chunk's messages are gone, the file is as it was before.
        """
        chunk = self._chunks.get(group)
        if chunk is None or not chunk.size:
            return False
        packed = chunk.take()
        counts = packed.counts
        try:
            self.open()
            self._write_waiting()
            offset = self.size
            self._append(*packed.buffers)
        except OSError as error:
            raise ChunkLost(error, self._named(counts)) from error
        for channel, count in counts.items():
            self._counts[channel] = self._counts.get(channel, 0) + count
            self.message_count += count
        self._start = min(self._start, packed.start)
        self._end = max(self._end, packed.end)
        self.chunk_count += 1
        ChunkIndex(
            message_start_time=packed.start,
            message_end_time=packed.end,
            chunk_start_offset=offset,
            chunk_length=packed.length,
            message_index_offsets=packed.index_offsets(offset),
            message_index_length=sum(map(len, packed.buffers[2:])),
            compression=packed.compression,
            compressed_size=len(packed.buffers[1]),
            uncompressed_size=packed.size,
        ).write(self._chunk_indexes)
        return True

    def add_record(self, opcode: int, content: bytes) -> None:
        """Add a record of any kind, as it is, in front of the next chunk."""
        self._waiting.write(_RECORD_HEAD.pack(opcode, len(content)))
        self._waiting.write(content)

    def write_attachment(self, index: AttachmentIndex, content: memoryview) -> None:
        """Write an attachment into the file.

        Args:
            index: describes it; its place in the file is filled in here.
            content: the record, without opcode and length.

        Raises:
            OSError: the file cannot be written.
        """
        self.open()
        self._write_waiting()
        index.offset, index.length = self.size, _RECORD_HEAD.size + len(content)
        self._append(_RECORD_HEAD.pack(Opcode.ATTACHMENT, len(content)), content)
        self._attachment_indexes.append(index)

    def sync(self) -> None:
        """Wait until what is in the file is on the disk (fdatasync)."""
        if self._file is not None:
            os.fdatasync(self._file)

    def finish(self) -> None:
        """Write the summary; open chunks must have been written.

        Raises:
            OSError: no room for the summary; everything up to here reads, by `recover` or a reader that goes through the file
                from the start.
        """
        self.open()
        self._write_waiting()
        DataEnd(0).write(self._waiting)
        summary_start = self.size + self._waiting.count
        summary, groups = RecordBuilder(), []
        statistics = Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self.chunk_count,
            message_count=self.message_count,
            message_end_time=self._end,
            message_start_time=self._start if self.message_count else 0,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )
        for opcode, records in (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunk_indexes.end()),
            (Opcode.ATTACHMENT_INDEX, self._attachment_indexes),
            (Opcode.METADATA_INDEX, self._metadata_indexes),
        ):
            start = summary.count
            if isinstance(records, bytes):
                summary.write(records)
            else:
                for record in records:
                    record.write(summary)
            if summary.count > start:
                groups.append(
                    SummaryOffset(group_opcode=opcode, group_start=summary_start + start, group_length=summary.count - start)
                )
        offsets_start = summary_start + summary.count
        for group in groups:
            group.write(summary)
        text = summary.end()
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, offsets_start)
        self._waiting.write(text)
        Footer(summary_start, offsets_start, zlib.crc32(footer, zlib.crc32(text))).write(self._waiting)
        self._waiting.write(MCAP0_MAGIC)
        self._append(self._waiting.end())

    def close(self) -> None:
        """Close the file; calling it again does nothing."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _named(self, counts: dict[int, int]) -> dict[tuple[str, str], int]:
        """Sum up counts of channels by topic and publisher, without what repeats the part before."""
        named: dict[tuple[str, str], int] = {}
        for id, count in counts.items():
            channel = self._channels[id - 1]
            if REPEATED not in channel.metadata:
                name = (channel.topic, channel.metadata.get("publisher", ""))
                named[name] = named.get(name, 0) + count
        return named

    def _write_waiting(self) -> None:
        if not self._waiting.count:
            return
        text = self._waiting.end()
        offset = self.size
        try:
            self._append(text)
        except OSError:
            self._waiting.write(text)
            raise
        self._metadata_indexes += [MetadataIndex(offset + at, length, name) for at, length, name in self._waiting_metadata]
        self._waiting_metadata.clear()

    def _append(self, *buffers: bytes | memoryview) -> None:
        assert self._file is not None
        total = sum(map(len, buffers))
        try:
            written = os.pwritev(self._file, buffers, self.size)
            if written < total:
                rest = memoryview(b"".join(buffers))
                while written < total:
                    written += os.pwrite(self._file, rest[written:], self.size + written)
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, self.size)
            raise
        self.size += total


def _lock(file: int) -> None:
    """Lock a file that was just created; a reader that looks at it at this moment holds the lock for microseconds."""
    for _ in range(_LOCK_TRIES):
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            time.sleep(0.001)
        except OSError:
            return  # a file system without locks: readers take the file for one that was cut short


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
