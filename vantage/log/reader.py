"""Reading logs: whole, in several parts, or broken off; fast, in the order in which they were written.

The file is gone through from record to record (no summary is needed, so that a log cut short by a crash reads as well as a
finished one); chunks are decompressed only when their turn comes and they hold a wanted topic.
"""

from __future__ import annotations

import mmap
import re
import struct
import warnings
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import lz4.frame
import msgspec
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from schemas import TOPICS, MalformedMessage, Message, decode
from vantage.log.metadata import GAPS, RUN
from vantage.log.writer import VIEWER_PREFIX

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<QQQII")
_LARGEST_CHUNK = 1 << 32


class BrokenLog(UserWarning):
    """Part of a log could not be read; the text says where and why."""


class Record(msgspec.Struct, frozen=True, gc=False):
    """One message of a log.

    Attributes:
        key: short key of the topic.
        publisher: who published it.
        sequence: the publisher's count (modulo 2^32).
        log_time: when it was recorded, ns since the Unix epoch.
        publish_time: when it was published, ns since the Unix epoch.
        payload: the bytes of the bus.
    """

    key: str
    publisher: str
    sequence: int
    log_time: int
    publish_time: int
    payload: bytes

    def decode(self) -> Message:
        """Return the message.

        Raises:
            MalformedMessage: the bytes are not a message of the topic's type, or the topic is not in the table.
        """
        topic = TOPICS.get(self.key)
        if topic is None:
            raise MalformedMessage(f"{self.key} is not in the topic table")
        return decode(topic.type, self.payload)


@dataclass(slots=True)
class _Chunk:
    """Where a run of messages lies in a file; `compression` None: bare records of an unchunked file."""

    start: int
    end: int
    offset: int
    length: int
    uncompressed: int
    crc: int
    compression: str | None
    channels: set[int] | None = None


def _read_records(kind: Any, data: bytes) -> Any:
    return kind.read(ReadDataStream(BytesIO(data)))


_DAMAGE = (struct.error, McapError, ValueError, LookupError, OverflowError, MemoryError, RuntimeError, zstandard.ZstdError)


class LogFile:
    """One MCAP file, gone through once when it is opened.

    Attributes:
        metadata: name -> the last metadata record of that name.
        schemas, channels: by their ids in this file.
        breaks: what could not be read, a line each; empty for a whole file.
        finished: whether the file was closed properly.
    """

    def __init__(self, path: Path) -> None:
        """Go through the file.

        Raises:
            OSError: it cannot be opened.
        """
        self.path = path
        self.metadata: dict[str, dict[str, str]] = {}
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.breaks: list[str] = []
        self.finished = False
        self.chunks: list[_Chunk] = []
        with path.open("rb") as file:
            size = file.seek(0, 2)
            self._map: mmap.mmap | bytes = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if size else b""
        self._size = size
        self._scan()

    def close(self) -> None:
        """Let go of the file."""
        if isinstance(self._map, mmap.mmap):
            self._map.close()

    def _scan(self) -> None:
        view = self._map
        if view[:8] != MCAP0_MAGIC:
            self.breaks.append("not an MCAP file" if self._size >= 8 else f"only {self._size} bytes")
            return
        position, bare = 8, None
        while position + 9 <= self._size:
            opcode, length = _HEAD.unpack_from(view, position)
            body, following = position + 9, position + 9 + length
            if following > self._size:
                break
            if opcode == Opcode.MESSAGE:
                if bare is None:
                    bare = _Chunk(2**64 - 1, 0, position, 0, 0, 0, None)
                    self.chunks.append(bare)
                time = struct.unpack_from("<Q", view, body + 6)[0] if length >= 22 else 0
                bare.start, bare.end = min(bare.start, time), max(bare.end, time)
                bare.length = following - bare.offset
            else:
                bare = None
                try:
                    self._take(opcode, view, body, length)
                except _DAMAGE as error:
                    self.breaks.append(f"damaged record at byte {position}: {error}")
                if opcode == Opcode.FOOTER:
                    self.finished = view[following : following + 8] == MCAP0_MAGIC
                    return
                if opcode == Opcode.DATA_END:
                    self.finished = True
                    if view[-8:] == MCAP0_MAGIC:
                        return
            position = following
        self.breaks.append(f"breaks off at byte {position} of {self._size}")

    def _take(self, opcode: int, view: mmap.mmap | bytes, body: int, length: int) -> None:
        match opcode:
            case Opcode.CHUNK:
                start, end, size, crc, name = _CHUNK.unpack_from(view, body)
                at = body + _CHUNK.size + name
                (stored,) = struct.unpack_from("<Q", view, at)
                if at + 8 + stored > body + length:
                    raise ValueError("chunk longer than its record")
                compression = bytes(view[body + _CHUNK.size : at]).decode()
                self.chunks.append(_Chunk(start, end, at + 8, stored, size, crc, compression))
            case Opcode.MESSAGE_INDEX:
                if self.chunks and length >= 6:
                    chunk = self.chunks[-1]
                    chunk.channels = chunk.channels or set()
                    chunk.channels.add(struct.unpack_from("<H", view, body)[0])
            case Opcode.SCHEMA:
                schema = _read_records(Schema, view[body : body + length])
                self.schemas[schema.id] = schema
            case Opcode.CHANNEL:
                channel = _read_records(Channel, view[body : body + length])
                self.channels[channel.id] = channel
            case Opcode.METADATA:
                record = _read_records(Metadata, view[body : body + length])
                self.metadata[record.name] = record.metadata

    def bytes_of(self, chunk: _Chunk) -> bytes:
        """Return the decompressed records of a chunk.

        Raises:
            ValueError and others: it is damaged.
        """
        stored = self._map[chunk.offset : chunk.offset + chunk.length]
        if chunk.uncompressed > _LARGEST_CHUNK:
            raise ValueError(f"chunk claims {chunk.uncompressed} bytes")
        match chunk.compression:
            case None | "":
                data = stored
            case "lz4":
                data = lz4.frame.decompress(stored)
            case "zstd":
                data = zstandard.ZstdDecompressor().decompress(stored, max_output_size=chunk.uncompressed)
            case other:
                raise ValueError(f"unknown compression {other!r}")
        if chunk.crc and zlib.crc32(data) != chunk.crc:
            raise ValueError("CRC does not match")
        return data

    def _wanted(self, topics: Collection[str] | None, viewer: bool, repeated: bool) -> dict[int, tuple[str, str]]:
        return {
            channel.id: (channel.topic, channel.metadata.get("publisher", ""))
            for channel in self.channels.values()
            if (topics is None or channel.topic in topics)
            and (viewer or not channel.topic.startswith(VIEWER_PREFIX))
            and (repeated or "repeated" not in channel.metadata)
        }

    def records(self, topics: Collection[str] | None, viewer: bool, repeated: bool) -> Iterator[Record]:
        """Yield the messages in order of their log times; what is damaged is left out and noted in `breaks`."""
        wanted = self._wanted(topics, viewer, repeated)
        known = set(self.channels)
        waiting: list[Record] = []
        for chunk in sorted(self.chunks, key=lambda chunk: chunk.start):
            if chunk.channels is not None and chunk.channels <= known and chunk.channels.isdisjoint(wanted):
                continue
            try:
                data = self.bytes_of(chunk)
                found = self._parse(data, wanted)
                if found is None:
                    wanted, known = self._wanted(topics, viewer, repeated), set(self.channels)
                    found = self._parse(data, wanted) or []
            except _DAMAGE as error:
                self.breaks.append(f"damaged chunk at byte {chunk.offset}: {error}")
                continue
            if waiting:
                # Chunks are sorted by their first message, so nothing before this one's start is still to come.
                waiting.sort(key=_log_time)
                ready = _bisect(waiting, chunk.start)
                yield from waiting[:ready]
                del waiting[:ready]
                waiting += found
            else:
                waiting = found
        waiting.sort(key=_log_time)
        yield from waiting

    def _parse(self, data: bytes, wanted: dict[int, tuple[str, str]]) -> list[Record] | None:
        """Return the wanted messages of a chunk; None when channels were met that were not known before."""
        found: list[Record] = []
        append, unpack = found.append, _MESSAGE.unpack_from
        position, size, fresh = 0, len(data), False
        while position + 9 <= size:
            if data[position] == 5:
                _, length, channel, sequence, log_time, publish_time = unpack(data, position)
                following = position + 9 + length
                if length < 22 or following > size:
                    raise ValueError("message longer than its chunk")
                name = wanted.get(channel)
                if name is not None:
                    append(Record(name[0], name[1], sequence, log_time, publish_time, data[position + 31 : following]))
                position = following
            else:
                opcode, length = _HEAD.unpack_from(data, position)
                body, position = position + 9, position + 9 + length
                if position > size:
                    raise ValueError("record longer than its chunk")
                if opcode == Opcode.CHANNEL:
                    channel_record = _read_records(Channel, data[body:position])
                    fresh |= channel_record.id not in self.channels
                    self.channels[channel_record.id] = channel_record
                elif opcode == Opcode.SCHEMA:
                    schema = _read_records(Schema, data[body:position])
                    self.schemas[schema.id] = schema
        return None if fresh else found


def _log_time(record: Record) -> int:
    return record.log_time


def _bisect(records: list[Record], time: int) -> int:
    low, high = 0, len(records)
    while low < high:
        middle = (low + high) // 2
        if records[middle].log_time < time:
            low = middle + 1
        else:
            high = middle
    return low


@dataclass
class Log:
    """A log: one run, in one part or more.

    Attributes:
        files: the parts, in order.
        breaks: `file: what could not be read`, complete once the records have been gone through.
    """

    files: list[LogFile] = field(default_factory=list)

    @property
    def breaks(self) -> list[str]:
        return [f"{file.path.name}: {text}" for file in self.files for text in file.breaks]

    @property
    def metadata(self) -> dict[str, str]:
        """The run's metadata; empty when the log has none."""
        return next((file.metadata[RUN] for file in self.files if RUN in file.metadata), {})

    @property
    def gaps(self) -> dict[str, int]:
        """`key publisher` -> lost messages, as far as the parts were closed properly."""
        total: dict[str, int] = {}
        for file in self.files:
            for name, count in file.metadata.get(GAPS, {}).items():
                total[name] = total.get(name, 0) + int(count)
        return total

    def records(self, topics: Collection[str] | None = None, viewer: bool = False) -> Iterator[Record]:
        """Yield the messages in order, over all parts; see `read`."""
        for number, file in enumerate(self.files):
            yield from file.records(topics, viewer, repeated=number == 0)

    def close(self) -> None:
        """Let go of the files."""
        for file in self.files:
            file.close()

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def find_logs(source: Path) -> list[list[Path]]:
    """Return the logs below `source`, each as the list of its parts.

    Args:
        source: a file, or a folder that is searched with its subfolders. `RUN_000.mcap`, `RUN_001.mcap`, ... are one log.

    Raises:
        FileNotFoundError: there is none.
    """
    if source.is_file():
        return [[source]]
    logs: dict[Path, list[Path]] = {}
    for path in sorted(source.rglob("*.mcap")):
        run = re.fullmatch(r"(.+)_\d{3,}", path.stem)
        logs.setdefault(path.with_name(run[1]) if run else path, []).append(path)
    if not logs:
        raise FileNotFoundError(f"{source}: no log (*.mcap) there")
    return list(logs.values())


def open_log(*parts: Path) -> Log:
    """Return the log that consists of these parts.

    Raises:
        OSError: a part cannot be opened.
    """
    return Log([LogFile(path) for path in parts])


def read(source: Path, topics: Collection[str] | None = None, viewer: bool = False) -> Iterator[Record]:
    """Yield the messages of a log in the order in which they were recorded.

    A log that was cut short or damaged yields what is whole and then warns with `BrokenLog`, which names the place.

    Args:
        source: a file, or a folder; of several logs in a folder, one comes after the other.
        topics: only these keys; the rest is not even decompressed where it lies in chunks of its own.
        viewer: also the channels for Foxglove and Lichtblick (keys `viewer/...`).

    Raises:
        FileNotFoundError: there is no log.
        OSError: a file cannot be opened.
    """
    for parts in find_logs(source):
        with open_log(*parts) as log:
            yield from log.records(topics, viewer)
            for text in log.breaks:
                warnings.warn(text, BrokenLog, stacklevel=2)
