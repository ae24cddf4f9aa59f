"""One MCAP file being written: chunks, indexes and summary, with nothing half-written left behind after an error.

The `mcap` package's own Writer keeps one compression for a whole file, cannot take a failed write back, and packs each message
through several small objects. This one uses `mcap`'s record classes for everything rare and packs messages itself. Its files
are checked with `mcap`'s readers in the test suite.
"""

from __future__ import annotations

import contextlib
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
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

Compression = Literal["zstd", "lz4", "none"]

_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS = 22
_CHUNK_HEAD = struct.Struct("<BQQQQII")
_INDEX_HEAD = struct.Struct("<BQHI")
_LENGTH = struct.Struct("<Q")

# Camera noise does not shrink: after a chunk that gained less than 3 %, seven are stored as they are before the next try.
_WORTHWHILE = 0.97
_TRIES_SKIPPED = 7

_compressors: dict[str, Callable[[bytes], bytes]] = {
    "zstd": lambda data: zstandard.ZstdCompressor(level=1).compress(data),
    "lz4": lz4.frame.compress,
}


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


class _Chunk:
    """Messages waiting to be written together."""

    __slots__ = ("compression", "end", "index", "pieces", "size", "skip", "start")

    def __init__(self, compression: Compression) -> None:
        self.compression: Compression = compression
        self.skip = 0
        self.clear()

    def clear(self) -> None:
        self.pieces: list[bytes] = []
        self.size = 0
        self.index: dict[int, list[int]] = {}
        self.start = 2**64 - 1
        self.end = 0

    def compressed(self, data: bytes) -> tuple[bytes, bytes]:
        """Return (name of the compression, bytes)."""
        if self.compression == "none":
            return b"", data
        if self.skip:
            self.skip -= 1
            return b"", data
        smaller = _compressors[self.compression](data)
        if len(smaller) > _WORTHWHILE * len(data):
            self.skip = _TRIES_SKIPPED
            return b"", data
        return self.compression.encode(), smaller


class Part:
    """An MCAP file being written.

    Messages wait in chunks, one open chunk for each `group` (bulky streams apart from small messages, each with its own
    compression); `write_chunks` puts them into the file. What is in the file is always whole records: a failed write is
    taken back before the error is raised.
    """

    def __init__(self, path: Path, chunk_size: int) -> None:
        """Create the file.

        Raises:
            FileExistsError: a log is never overwritten.
            OSError: the file cannot be created or its first bytes not be written.
        """
        self.path = path
        self.size = 0
        self.message_count = 0
        self._chunk_size = chunk_size
        self._chunks: dict[str, _Chunk] = {}
        self._waiting = RecordBuilder()
        self._waiting_metadata: list[tuple[int, int, str]] = []
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunk_indexes: list[ChunkIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}
        self._start = 2**64 - 1
        self._end = 0
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        try:
            self._waiting.write(MCAP0_MAGIC)
            Header(profile="", library="vantage").write(self._waiting)
            self._write_waiting()
        except OSError:
            os.close(self._file)
            os.unlink(path)
            raise

    @property
    def pending(self) -> int:
        """Bytes of messages that are not in the file yet."""
        return sum(chunk.size for chunk in self._chunks.values())

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
        length = len(payload)
        # First of all, because it refuses a number that is out of range.
        head = _MESSAGE_HEAD.pack(
            Opcode.MESSAGE, length + _MESSAGE_FIELDS, channel, sequence & 0xFFFFFFFF, log_time, publish_time
        )
        chunk = self._chunks.get(group)
        if chunk is None:
            chunk = self._chunks[group] = _Chunk(compression)
        entries = chunk.index.get(channel)
        if entries is None:
            entries = chunk.index[channel] = []
        entries.append(log_time)
        entries.append(chunk.size)
        chunk.pieces.append(head)
        chunk.pieces.append(payload)
        chunk.size += length + _MESSAGE_HEAD.size
        if log_time < chunk.start:
            chunk.start = log_time
        if log_time > chunk.end:
            chunk.end = log_time
        return chunk.size >= self._chunk_size

    def write_chunk(self, group: str) -> None:
        """Write the open chunk of `group` into the file.

        Raises:
            ChunkLost: the file could not be written; the chunk's messages are gone, the file is as it was before.
        """
        chunk = self._chunks.get(group)
        if chunk is None or not chunk.size:
            return
        data = b"".join(chunk.pieces)
        compression, stored = chunk.compressed(data)
        start, end, size, index = chunk.start, chunk.end, chunk.size, chunk.index
        chunk.clear()
        counts = {channel: len(entries) // 2 for channel, entries in index.items()}
        try:
            self._write_waiting()
            offset = self.size
            length = _CHUNK_HEAD.size - 9 + len(compression) + 8 + len(stored)
            head = _CHUNK_HEAD.pack(Opcode.CHUNK, length, start, end, size, zlib.crc32(data), len(compression))
            head += compression + _LENGTH.pack(len(stored))
            records: list[bytes] = []
            index_offsets: dict[int, int] = {}
            index_offset = offset + len(head) + len(stored)
            for channel, entries in index.items():
                index_offsets[channel] = index_offset
                record = _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + 8 * len(entries), channel, 8 * len(entries))
                record += struct.pack(f"<{len(entries)}Q", *entries)
                records.append(record)
                index_offset += len(record)
            self._append(head, stored, *records)
        except OSError as error:
            dropped: dict[tuple[str, str], int] = {}
            for channel, count in counts.items():
                lost = self._channels[channel - 1]
                name = (lost.topic, lost.metadata.get("publisher", ""))
                dropped[name] = dropped.get(name, 0) + count
            raise ChunkLost(error, dropped) from error
        for channel, count in counts.items():
            self._counts[channel] = self._counts.get(channel, 0) + count
            self.message_count += count
        self._start = min(self._start, start)
        self._end = max(self._end, end)
        self._chunk_indexes.append(
            ChunkIndex(
                message_start_time=start,
                message_end_time=end,
                chunk_start_offset=offset,
                chunk_length=len(head) + len(stored),
                message_index_offsets=index_offsets,
                message_index_length=sum(map(len, records)),
                compression=compression.decode(),
                compressed_size=len(stored),
                uncompressed_size=size,
            )
        )

    @property
    def groups(self) -> list[str]:
        """The groups that have had messages."""
        return list(self._chunks)

    def sync(self) -> None:
        """Wait until what is in the file is on the disk (fdatasync)."""
        os.fdatasync(self._file)

    def finish(self) -> None:
        """Write the summary; open chunks must have been written.

        Raises:
            OSError: no room for the summary; everything up to here reads, by `recover` or a reader that goes through the file
                from the start.
        """
        self._write_waiting()
        DataEnd(0).write(self._waiting)
        summary_start = self.size + self._waiting.count
        summary, groups = RecordBuilder(), []
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunk_indexes),
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
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.METADATA_INDEX, self._metadata_indexes),
        ):
            start = summary.count
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
        """Close the file."""
        os.close(self._file)

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

    def _append(self, *buffers: bytes) -> None:
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
