"""Messages that wait to be written together: an open chunk of a part."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from mcap.opcode import Opcode

from vantage.log.compression import COMPRESSORS, Compression

_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS = 22
_CHUNK_HEAD = struct.Struct("<BQQQQII")
_INDEX_HEAD = struct.Struct("<BQHI")
_LENGTH = struct.Struct("<Q")

# Camera noise does not shrink: after a chunk that gained less than 3 %, seven are stored as they are before the next try.
_WORTHWHILE = 0.97
_TRIES_SKIPPED = 7


@dataclass(frozen=True, slots=True)
class PackedChunk:
    """A chunk as it goes into a file.

    Attributes:
        buffers: the chunk record in two pieces, then the message index records.
        index: channel -> times and offsets of its messages, alternating.
        length: bytes of the chunk record.
        start, end: log times of the first and the last message.
        size: bytes before compression.
        compression: as the chunk names it.
    """

    buffers: list[bytes]
    index: dict[int, list[int]]
    length: int
    start: int
    end: int
    size: int
    compression: str

    @property
    def counts(self) -> dict[int, int]:
        """Channel -> messages."""
        return {channel: len(entries) // 2 for channel, entries in self.index.items()}

    def index_offsets(self, offset: int) -> dict[int, int]:
        """Return where in the file the message index of each channel stands, the chunk being at `offset`."""
        offsets = {}
        offset += self.length
        for channel, record in zip(self.index, self.buffers[2:], strict=True):
            offsets[channel] = offset
            offset += len(record)
        return offsets


class OpenChunk:
    """See module.

    Attributes:
        size: bytes of the messages that wait.
    """

    __slots__ = ("_compression", "_end", "_index", "_pieces", "_skip", "_start", "size")

    def __init__(self, compression: Compression) -> None:
        self._compression: Compression = compression
        self._skip = 0
        self._clear()

    def _clear(self) -> None:
        self._pieces: list[bytes] = []
        self.size = 0
        self._index: dict[int, list[int]] = {}
        self._start = 2**64 - 1
        self._end = 0

    def add(self, channel: int, sequence: int, log_time: int, publish_time: int, payload: bytes) -> None:
        """Add a message.

        Raises:
            struct.error: a number is out of range; the chunk is as it was before.
        """
        length = len(payload)
        # First of all, because it refuses a number that is out of range.
        head = _MESSAGE_HEAD.pack(
            Opcode.MESSAGE, length + _MESSAGE_FIELDS, channel, sequence & 0xFFFFFFFF, log_time, publish_time
        )
        entries = self._index.get(channel)
        if entries is None:
            entries = self._index[channel] = []
        entries.append(log_time)
        entries.append(self.size)
        self._pieces.append(head)
        self._pieces.append(payload)
        self.size += length + _MESSAGE_HEAD.size
        if log_time < self._start:
            self._start = log_time
        if log_time > self._end:
            self._end = log_time

    def take(self) -> PackedChunk:
        """Return everything that waits, packed; the chunk is empty afterwards."""
        data = b"".join(self._pieces)
        name, stored = self._compressed(data)
        length = _CHUNK_HEAD.size - 9 + len(name) + 8 + len(stored)
        head = _CHUNK_HEAD.pack(Opcode.CHUNK, length, self._start, self._end, self.size, zlib.crc32(data), len(name))
        buffers = [head + name + _LENGTH.pack(len(stored)), stored]
        for channel, entries in self._index.items():
            record = _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + 8 * len(entries), channel, 8 * len(entries))
            buffers.append(record + struct.pack(f"<{len(entries)}Q", *entries))
        packed = PackedChunk(buffers, self._index, length + 9, self._start, self._end, self.size, name.decode())
        self._clear()
        return packed

    def _compressed(self, data: bytes) -> tuple[bytes, bytes]:
        """Return (name of the compression, bytes)."""
        if self._compression == "none":
            return b"", data
        if self._skip:
            self._skip -= 1
            return b"", data
        smaller = COMPRESSORS[self._compression](data)
        if len(smaller) > _WORTHWHILE * len(data):
            self._skip = _TRIES_SKIPPED
            return b"", data
        return self._compression.encode(), smaller
