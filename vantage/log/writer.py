"""Writing a log: the bytes of the bus into MCAP files, in parts, safe against crashes and full disks."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from schemas import TOPICS, Gap, Topic, encode
from schemas.json_schema import json_schema
from vantage.log.metadata import GAPS, PART, REPEATED, RUN, VIEWER_PREFIX, RunMetadata
from vantage.log.part import ChunkLost, Compression, Part

if TYPE_CHECKING:
    from vantage.log.viewer import ViewerMessage

Translate = Callable[[str, bytes], "Iterable[ViewerMessage]"]

FLUSH_PERIOD = 1_000_000_000
"""ns; what a crash can cost at most."""
MOST_CHANNELS = 4096
"""Channels of one part; what strangers say beyond them stands together on the channel `**` (MCAP counts to 65535)."""
_BULKY = 32 * 1024
_RETRY_PERIOD = 1_000_000_000


def is_latched(topic: Topic) -> bool:
    """Whether a topic's last message stays valid until the next: then every part of a log repeats it."""
    return topic.history > 0 and topic.rate == 0


def part_path(path: Path, number: int) -> Path:
    """Return where part `number` of the run at `path` (`RUN.mcap` or `RUN`) lies: `RUN_000.mcap`, ..."""
    return path.with_name(f"{path.name.removesuffix('.mcap')}_{number:03d}.mcap")


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


class _Route:
    """Where the messages of one (topic, publisher) go, in the present part."""

    __slots__ = ("bulk_compression", "bulk_group", "channel", "compression", "latched")

    def __init__(self, channel: int, kind: str, compression: Compression, latched: bool) -> None:
        self.channel = channel
        self.compression = compression
        self.bulk_compression: Compression = "none" if compression == "none" else "lz4"
        self.bulk_group = kind
        self.latched = latched


class LogWriter:
    """Writes messages into a log, in the order of the calls.

    Every part begins with the run's metadata and repeats the latched topics (on a channel marked `repeated`, which `read`
    skips when it reads the parts as one). Log times are made strictly increasing, by at most as many nanoseconds as messages
    came in the same instant, so that the order of the log can be told from its times alone.

    Messages wait in memory until a chunk is full or `flush_period` has passed since the last flush; a write checks the clock,
    a writer that is not written to wants `flush` called. Each flush is followed by fdatasync in a thread of its own.

    A disk that is full does not raise: messages are dropped and counted, `error` says so in one line, what is in the file
    stays readable, and writing goes on when there is room again (the loss is then in the log as gaps).

    Use by one thread at a time.
    """

    def __init__(
        self,
        path: Path,
        metadata: RunMetadata | dict[str, str],
        *,
        compression: Compression = "zstd",
        chunk_size: int = 1 << 20,
        split_bytes: int | None = None,
        split_seconds: float | None = None,
        viewer: Translate | None = None,
        sync: bool = True,
        flush_period: int = FLUSH_PERIOD,
    ) -> None:
        """Create the first part.

        Args:
            path: the file; with `split_bytes` or `split_seconds`, parts are named `NAME_000.mcap`, `NAME_001.mcap`, ...
            metadata: the first record of every part.
            compression: of small messages; messages above 32 KiB (camera pictures) use `lz4` in chunks of their own, and are
                stored as they are where that gains nothing; `none` holds for all.
            chunk_size: bytes of messages compressed together.
            split_bytes: begin a new part when one has this size.
            split_seconds: begin a new part after this time (of the log).
            viewer: `vantage.log.viewer.Viewer(...).translate`, to write channels for Foxglove and Lichtblick beside.
            sync: call fdatasync with every flush.
            flush_period: ns.

        Raises:
            FileExistsError: a log is never overwritten.
            OSError: the file cannot be created.
        """
        self.path = path
        self.error: str | None = None
        self.dropped: dict[tuple[str, str], int] = {}
        self.gaps: dict[tuple[str, str], int] = {}
        self.message_count = 0
        self.undeclared = 0
        self.malformed = 0
        self._metadata = metadata.as_text() if isinstance(metadata, RunMetadata) else dict(metadata)
        self._compression = compression
        self._chunk_size = chunk_size
        self._split_bytes = split_bytes
        self._split_time = None if split_seconds is None else int(split_seconds * 1e9)
        self._viewer = viewer
        self._sync = sync
        self._flush_period = flush_period
        self._splits = split_bytes is not None or split_seconds is not None
        self._part_number = 0
        self._last_time = 0
        self._part_start: int | None = None
        self._gap_sequence = 0
        self._unreported: dict[tuple[str, str], int] = {}
        self._latched: dict[tuple[str, str], tuple[bytes, int, int]] = {}
        self._retry_at = 0
        self._syncing: Future[None] | None = None
        self._sync_thread: ThreadPoolExecutor | None = None
        self._closed = False
        self._synced: tuple[Part, int] | None = None
        self._part = self._open_part()
        self._flushed_at = time.monotonic_ns()

    @property
    def part(self) -> Path:
        """The file being written."""
        return self._part.path

    @property
    def parts_begun(self) -> int:
        """How many files there are."""
        return self._part_number

    @property
    def size(self) -> int:
        """Bytes of the present part that are in its file."""
        return self._part.size

    def write(
        self,
        key: str,
        payload: bytes,
        *,
        log_time: int,
        publish_time: int,
        sequence: int,
        publisher: str,
        well_formed: bool = True,
    ) -> None:
        """Add a message, as it was on the bus.

        Args:
            key: short key; one that is not in the topic table is written without a schema and counted.
            payload: the message's bytes.
            log_time: when it was received, ns since the Unix epoch.
            publish_time: when it was published, ns since the Unix epoch.
            sequence: the publisher's count of its messages on this topic.
            publisher: who published it.
            well_formed: false for bytes that did not decode as the topic's type: they are kept on a channel without a schema.
        """
        if self._splits and self._is_full(log_time):
            self.split()
        if log_time <= self._last_time:
            log_time = self._last_time + 1
        self._last_time = log_time
        if self._part_start is None:
            self._part_start = log_time
        route = self._routes.get((key, publisher, well_formed))
        if route is None:
            route = self._add_route(key, publisher, well_formed)
        if not well_formed:
            self.malformed += 1
        elif key not in TOPICS:
            self.undeclared += 1
        self._put(route, sequence, log_time, publish_time, payload)
        if route.latched:
            self._latched[key, publisher] = (payload, publish_time, sequence)
        if self._viewer is not None and well_formed:
            self._write_viewer(key, payload, log_time, publish_time)
        if time.monotonic_ns() - self._flushed_at >= self._flush_period:
            self.flush(wait=False)

    def gap(self, key: str, publisher: str, missed: int, *, log_time: int = 0) -> None:
        """Note that messages were lost before they came here: in the log (topic `gap`) and in the part's metadata."""
        for gaps in (self.gaps, self._part_gaps):
            gaps[key, publisher] = gaps.get((key, publisher), 0) + missed
        log_time = max(log_time, self._last_time + 1)
        note = encode(Gap(stamp=log_time, key=key[:200], publisher=publisher[:200], missed=missed))
        self._gap_sequence += 1
        self.write("gap", note, log_time=log_time, publish_time=log_time, sequence=self._gap_sequence, publisher="recorder")

    def flush(self, wait: bool = True) -> None:
        """Put everything that waits into the file, and (with `sync`) onto the disk.

        Args:
            wait: return when the disk has it; else fdatasync goes on in its thread.
        """
        self._flushed_at = time.monotonic_ns()
        if self._part.pending:
            for group in self._part.groups:
                self._write_chunk(self._part, group)
        if self._unreported and self.error is None:
            lost, self._unreported = self._unreported, {}
            for (key, publisher), missed in lost.items():
                self.gap(key, publisher, missed)
        if self._sync and self._synced != (self._part, self._part.size):
            if self._syncing is None or self._syncing.done() or wait:
                self._sync_result()
                self._synced = (self._part, self._part.size)
                self._in_sync_thread(self._part.sync)
            if wait:
                self._sync_result()

    def split(self) -> None:
        """Begin a new part: the next file is open before the present one is closed."""
        before, gaps = self._part, self._part_gaps
        try:
            self._part = self._open_part()
        except OSError as error:
            self._fail(before, error)
            self._retry_at = self._last_time + _RETRY_PERIOD
            return
        self._finish(before, gaps)

    def close(self) -> None:
        """Write what waits, finish the file and close it. Calling it again does nothing."""
        if self._closed:
            return
        self.flush(wait=False)
        self._closed = True
        self._finish(self._part, self._part_gaps)
        self._sync_result()
        if self._sync_thread is not None:
            self._sync_thread.shutdown()

    def __enter__(self) -> LogWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _is_full(self, log_time: int) -> bool:
        if log_time < self._retry_at or self._part_start is None:
            return False
        if self._split_time is not None and log_time - self._part_start >= self._split_time:
            return True
        return self._split_bytes is not None and self._part.size + self._part.pending >= self._split_bytes

    def _open_part(self) -> Part:
        number = self._part_number
        is_part = self._splits or number > 0
        part = Part(part_path(self.path, number) if is_part else self.path, self._chunk_size)
        self._part_number += 1
        self._part = part
        self._part_start = None
        self._routes: dict[tuple[str, str, bool], _Route] = {}
        self._viewer_routes: dict[str, _Route] = {}
        self._schemas: dict[str, int] = {}
        self._part_gaps: dict[tuple[str, str], int] = {}
        if self._sync:
            # Else a power cut may take the file's name, and so all of it.
            _sync_folder(part.path.parent)
        part.add_metadata(RUN, {**self._metadata, PART: str(number)} if is_part else self._metadata)
        for (key, publisher), (payload, publish_time, sequence) in self._latched.items():
            self._last_time += 1
            route = self._add_route(key, publisher, True, repeated=True)
            self._put(route, sequence, self._last_time, publish_time, payload)
        return part

    def _add_route(self, key: str, publisher: str, well_formed: bool, repeated: bool = False) -> _Route:
        topic = TOPICS.get(key)
        is_stranger = topic is None or publisher not in topic.publishers
        if is_stranger and not repeated and len(self._routes) >= MOST_CHANNELS:
            key, publisher, well_formed = "**", "", False
            if (known := self._routes.get((key, publisher, well_formed))) is not None:
                return known
        metadata = {"publisher": publisher}
        if not well_formed:
            topic = None
        if topic is None:
            channel = self._part.add_channel(key, "", 0, metadata)
            route = _Route(channel, "unknown", self._compression, False)
        else:
            kind = topic.type.__name__
            if kind not in self._schemas:
                self._schemas[kind] = self._part.add_schema(kind, "jsonschema", json_schema(topic.type))
            metadata |= {"delivery": topic.delivery, "rate": f"{topic.rate:g}"}
            if repeated:
                metadata[REPEATED] = "true"
            channel = self._part.add_channel(key, "msgpack", self._schemas[kind], metadata)
            route = _Route(channel, kind, self._compression, is_latched(topic))
        if not repeated:
            self._routes[key, publisher, well_formed] = route
        return route

    def _write_viewer(self, key: str, payload: bytes, log_time: int, publish_time: int) -> None:
        assert self._viewer is not None
        for message in self._viewer(key, payload):
            route = self._viewer_routes.get(message.topic)
            if route is None:
                if message.schema_name not in self._schemas:
                    self._schemas[message.schema_name] = self._part.add_schema(message.schema_name, "protobuf", message.schema)
                topic = VIEWER_PREFIX + message.topic
                channel = self._part.add_channel(topic, "protobuf", self._schemas[message.schema_name], {})
                route = self._viewer_routes[message.topic] = _Route(channel, message.schema_name, self._compression, False)
            self._put(route, 0, log_time, publish_time, message.payload)

    def _put(self, route: _Route, sequence: int, log_time: int, publish_time: int, payload: bytes) -> None:
        group, compression = "", route.compression
        if len(payload) >= _BULKY:
            group, compression = route.bulk_group, route.bulk_compression
        self.message_count += 1
        if self._part.add_message(route.channel, group, compression, sequence, log_time, publish_time, payload):
            self._write_chunk(self._part, group)

    def _write_chunk(self, part: Part, group: str) -> None:
        try:
            part.write_chunk(group)
        except ChunkLost as lost:
            for name, missed in lost.dropped.items():
                self.dropped[name] = self.dropped.get(name, 0) + missed
                if name[0] != "gap" and not name[0].startswith(VIEWER_PREFIX):
                    self._unreported[name] = self._unreported.get(name, 0) + missed
            self._fail(part, lost.error)
            if lost.error.errno == errno.EFBIG and part is self._part:
                self.split()
        else:
            self.error = None

    def _fail(self, part: Part, error: OSError) -> None:
        what = "the disk is full" if error.errno in (errno.ENOSPC, errno.EDQUOT) else (error.strerror or str(error))
        dropped = sum(missed for (key, _), missed in self.dropped.items() if not key.startswith(VIEWER_PREFIX))
        self.error = f"{part.path}: {what}; messages dropped so far: {dropped}"

    def _finish(self, part: Part, gaps: dict[tuple[str, str], int]) -> None:
        for group in part.groups:
            self._write_chunk(part, group)
        if gaps:
            part.add_metadata(GAPS, {f"{key} {publisher}": str(missed) for (key, publisher), missed in gaps.items()})
        try:
            part.finish()
        except OSError as error:
            self._fail(part, error)
        if self._sync:
            self._in_sync_thread(part.sync)
            self._in_sync_thread(part.close)
        else:
            part.close()

    def _in_sync_thread(self, action: Callable[[], None]) -> None:
        if self._sync_thread is None:
            self._sync_thread = ThreadPoolExecutor(1, thread_name_prefix="log-sync")
        self._syncing = self._sync_thread.submit(action)

    def _sync_result(self) -> None:
        """Wait for the sync thread and take note of its error."""
        syncing, self._syncing = self._syncing, None
        if syncing is not None:
            try:
                syncing.result()
            except OSError as error:
                self._fail(self._part, error)
