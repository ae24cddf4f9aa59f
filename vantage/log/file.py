"""One MCAP file being read: gone through from record to record, whole or broken off.

No summary is needed, so that a log cut short by a crash reads as well as a finished one; chunks are decompressed only when their
turn comes and they hold a wanted channel.
"""

from __future__ import annotations

import fcntl
import mmap
import struct
import zlib
from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from operator import itemgetter
from pathlib import Path
from typing import Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from vantage.log.compression import decompress
from vantage.log.metadata import RUN

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<QQQII")
_TIME = struct.Struct("<Q")
_MOST_MESSAGES = 1 << 20
"""Messages of a chunk above which it is refused: what they weigh in memory is not bounded by their bytes."""
_PRIVATE = 0x80
"""Opcodes from here on are for other programs' own records."""
_BARE_CHUNK = 1 << 20
"""Bytes of an unchunked file that are read together."""


@dataclass(slots=True)
class Chunk:
    """Where a run of messages lies in a file; `compression` None: bare records of an unchunked file."""

    start: int
    end: int
    offset: int
    length: int
    uncompressed: int
    crc: int
    compression: str | None
    channels: set[int] | None = None


def _read_record(kind: Any, data: bytes) -> Any:
    return kind.read(ReadDataStream(BytesIO(data)))


def read_metadata(content: bytes) -> Metadata:
    """Return the metadata record with this content."""
    record: Metadata = _read_record(Metadata, content)
    return record


DAMAGE = (struct.error, McapError, ValueError, LookupError, OverflowError, MemoryError, RuntimeError, zstandard.ZstdError)


RawMessage = tuple[int, int, int, int, bytes]
"""Channel id, sequence, log time, publish time, payload."""

_log_time = itemgetter(2)


class LogFile:
    """One MCAP file, gone through once when it is opened.

    Attributes:
        profile, library: of the header.
        metadata: name -> the last metadata record of that name.
        extras: (opcode, start, end) of every metadata record, attachment and private record, in order.
        schemas, channels: by their ids in this file.
        breaks: what could not be read, a line each; empty for a whole file.
        finished: whether the file was closed properly.
        recording: whether a writer has the file open now: that it ends somewhere is no fault then.
    """

    def __init__(self, path: Path) -> None:
        """Go through the file.

        Raises:
            OSError: it cannot be opened.
        """
        self.path = path
        self.profile = self.library = ""
        self.metadata: dict[str, dict[str, str]] = {}
        self.extras: list[tuple[int, int, int]] = []
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.breaks: list[str] = []
        self.finished = False
        self.chunks: list[Chunk] = []
        self._opened: mmap.mmap | bytes | None = None
        # Before the size is taken: a file that is closed in between must not look broken.
        self.recording = is_recorded_now(path)
        self._size = len(self.content)
        self._scan()
        self.recording &= not self.finished
        self._learn_channels()

    @property
    def is_mcap(self) -> bool:
        """Whether the file begins as every MCAP file does."""
        return self.content[:8] == MCAP0_MAGIC

    @property
    def content(self) -> mmap.mmap | bytes:
        """The file's bytes; a file that was closed is opened again.

        Raises:
            OSError: it cannot be opened.
        """
        if self._opened is None:
            with self.path.open("rb") as file:
                size = file.seek(0, 2)
                self._opened = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if size else b""
        return self._opened

    def close(self) -> None:
        """Let go of the file, until something is read from it again."""
        opened, self._opened = self._opened, None
        if isinstance(opened, mmap.mmap):
            opened.close()

    def _note(self, text: str) -> None:
        if text not in self.breaks:
            self.breaks.append(text)

    def _scan(self) -> None:
        view = self.content
        if not self.is_mcap:
            self._note("not an MCAP file" if self._size >= 8 else f"only {self._size} bytes")
            return
        position, bare = 8, None
        while position + 9 <= self._size:
            opcode, length = _HEAD.unpack_from(view, position)
            body, following = position + 9, position + 9 + length
            if following > self._size:
                break
            if opcode == Opcode.MESSAGE:
                if bare is None or bare.length >= _BARE_CHUNK:
                    bare = Chunk(2**64 - 1, 0, position, 0, 0, 0, None)
                    self.chunks.append(bare)
                time = _TIME.unpack_from(view, body + 6)[0] if length >= 22 else 0
                bare.start, bare.end = min(bare.start, time), max(bare.end, time)
                bare.length = following - bare.offset
            else:
                bare = None
                try:
                    self._take(opcode, view, body, length)
                except DAMAGE as error:
                    self._note(f"damaged record at byte {position}: {error}")
                if opcode == Opcode.FOOTER:
                    self.finished = view[following : following + 8] == MCAP0_MAGIC
                    if not self.finished:
                        self._note("the last bytes are missing")
                    return
            position = following
        if not self.recording:
            where = f"of {self._size}" if position < self._size else "(its end)"
            self._note(f"breaks off at byte {position} {where}: it was not closed")
        if self.chunks:
            self.chunks[-1].channels = None  # its index may be cut off, too

    def _take(self, opcode: int, view: mmap.mmap | bytes, body: int, length: int) -> None:
        match opcode:
            case Opcode.CHUNK:
                start, end, size, crc, name = _CHUNK.unpack_from(view, body)
                at = body + _CHUNK.size + name
                (stored,) = struct.unpack_from("<Q", view, at)
                if at + 8 + stored > body + length:
                    raise ValueError("chunk longer than its record")
                compression = bytes(view[body + _CHUNK.size : at]).decode()
                self.chunks.append(Chunk(start, end, at + 8, stored, size, crc, compression))
            case Opcode.MESSAGE_INDEX:
                if self.chunks and length >= 6:
                    chunk = self.chunks[-1]
                    chunk.channels = chunk.channels or set()
                    chunk.channels.add(struct.unpack_from("<H", view, body)[0])
            case Opcode.SCHEMA:
                schema = _read_record(Schema, view[body : body + length])
                self.schemas[schema.id] = schema
            case Opcode.CHANNEL:
                channel = _read_record(Channel, view[body : body + length])
                self.channels[channel.id] = channel
            case Opcode.METADATA:
                record = read_metadata(view[body : body + length])
                self.metadata[record.name] = record.metadata
                self.extras.append((opcode, body, body + length))
            case Opcode.HEADER:
                header = _read_record(Header, view[body : body + length])
                self.profile, self.library = header.profile, header.library
            case _ if opcode == Opcode.ATTACHMENT or opcode >= _PRIVATE:
                self.extras.append((opcode, body, body + length))

    def bytes_of(self, chunk: Chunk) -> bytes:
        """Return the decompressed records of a chunk.

        Raises:
            ValueError and others: it is damaged.
        """
        stored = self.content[chunk.offset : chunk.offset + chunk.length]
        if chunk.compression is None:
            return stored
        data = decompress(stored, chunk.compression, chunk.uncompressed)
        if chunk.crc and zlib.crc32(data) != chunk.crc:
            raise ValueError("CRC does not match")
        return data

    def messages_of(self, chunk: Chunk) -> list[RawMessage]:
        """Return the messages of a chunk as they stand in it; none, and a line in `breaks`, when it is damaged."""
        try:
            return self._parse(self.bytes_of(chunk))
        except DAMAGE as error:
            self._note(f"damaged chunk at byte {chunk.offset}: {error}")
            return []

    def messages(self, wanted: Callable[[Channel], bool], after: int = -1) -> Iterator[RawMessage]:
        """Yield the messages of the wanted channels in order of their log times; what is damaged is noted in `breaks`.

        Args:
            after: only what was recorded later, ns; chunks that end before are not even decompressed.
        """
        ids = {id for id, channel in self.channels.items() if wanted(channel)}
        waiting: list[RawMessage] = []
        for chunk in sorted((chunk for chunk in self.chunks if chunk.end > after), key=lambda chunk: chunk.start):
            held = chunk.channels
            if held is not None and held.isdisjoint(ids):
                continue
            found = self.messages_of(chunk)
            if held is None or not held <= ids or chunk.start <= after:
                found = [message for message in found if message[0] in ids and message[2] > after]
            if waiting:
                # Chunks come sorted by their first message, so nothing before this one's start is still to come.
                waiting.sort(key=_log_time)
                ready = bisect_left(waiting, chunk.start, key=_log_time)
                yield from waiting[:ready]
                del waiting[:ready]
                waiting += found
            else:
                waiting = found
        waiting.sort(key=_log_time)
        yield from waiting

    def _learn_channels(self) -> None:
        """Other programs describe a channel within the chunk that first uses it, which a file cut short repeats nowhere."""
        for chunk in self.chunks:
            if chunk.compression is None:
                continue  # in an unchunked file channels stand between the messages
            if chunk.channels is None or not chunk.channels <= self.channels.keys():
                self.messages_of(chunk)

    def _parse(self, data: bytes) -> list[RawMessage]:
        found: list[RawMessage] = []
        append, unpack = found.append, _MESSAGE.unpack_from
        position, size = 0, len(data)
        while position + 9 <= size:
            if data[position] == 5:
                _, length, channel, sequence, log_time, publish_time = unpack(data, position)
                following = position + 9 + length
                if length < 22 or following > size:
                    raise ValueError("message longer than its chunk")
                append((channel, sequence, log_time, publish_time, data[position + 31 : following]))
                if len(found) > _MOST_MESSAGES:
                    raise ValueError(f"more than {_MOST_MESSAGES} messages in one chunk")
            else:
                opcode, length = _HEAD.unpack_from(data, position)
                following = position + 9 + length
                if not opcode:
                    raise ValueError("a record of no kind")
                if following > size:
                    raise ValueError("record longer than its chunk")
                if opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
                    self._take(opcode, data, position + 9, length)
            position = following
        return found


def first_metadata(path: Path) -> dict[str, str]:
    """Return the metadata record a log of ours begins with, without going through the file; empty for another file."""
    with path.open("rb") as file:
        start = file.read(1 << 16)
    position = 8
    try:
        while start[:8] == MCAP0_MAGIC:
            opcode, length = _HEAD.unpack_from(start, position)
            body, position = position + 9, position + 9 + length
            if opcode == Opcode.METADATA:
                record = read_metadata(start[body:position])
                return record.metadata if record.name == RUN else {}
            if opcode != Opcode.HEADER:
                break
    except DAMAGE:
        pass
    return {}


def is_recorded_now(path: Path) -> bool:
    """Return whether a writer has this file open (see `Part.open`).

    Raises:
        OSError: it cannot be opened.
    """
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            pass  # a file system without locks
    return False
