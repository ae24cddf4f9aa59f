"""Writing a log: the bytes of the bus into MCAP files, in parts, safe against crashes and full disks."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from schemas import TOPICS, Gap, encode
from vantage.log.compression import Compression
from vantage.log.losses import MOST_NAMES, NOTES, Losses, Name, add_to, has_room
from vantage.log.metadata import GAPS, NEXT, PART, RUN, RunMetadata
from vantage.log.names import part_path
from vantage.log.part import FILE_MODE, FOLDER_MODE, ChunkLost, Part
from vantage.log.routes import Route, Routes
from vantage.log.sync_thread import SyncThread
from vantage.printable import counted

if TYPE_CHECKING:
    from vantage.log.viewer import ViewerMessage

Translate = Callable[[str, bytes], "Iterable[ViewerMessage]"]

FLUSH_PERIOD = 1_000_000_000
"""ns; what a crash can cost at most."""
MOST_CHUNKS = 1 << 16
"""Chunks of one part, where a log has several: the index of a part is in memory until the part ends (about 300 bytes a chunk)."""
_BULKY = 32 * 1024
_RETRY_PERIOD = 1_000_000_000


class LogWriter:
    """Writes messages into a log, in the order of the calls.

    Every part begins with the run's metadata and repeats the latched topics (on a channel marked `repeated`, which `read`
    skips when it reads the parts as one). Log times are made strictly increasing, by at most as many nanoseconds as messages
    came in the same instant.

    Messages wait in memory until a chunk is full or `flush_period` has passed since the last flush; a write checks the clock,
    a writer that is not written to wants `flush` called. Each flush is followed by fdatasync in a thread of its own.

    When the disk refuses (it is full, read-only, the folder is gone), the call raises OSError. With `keep_going` it does not:
    messages are dropped and counted, `error` names the reason in one line for as long as it holds, what is in the file stays
    readable, and writing goes on when there is room again, with a note of each loss (topic `gap`). A file that was deleted or
    moved meanwhile is followed by another part.

    Use by one thread at a time.

    Attributes:
        error: why the last flush, or a chunk since, was not written; None when all is well.
        displaced: the last time that a file was deleted or moved while it was being written, in one line; empty when none was.
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
        keep_going: bool = False,
        file_mode: int = FILE_MODE,
        folder_mode: int = FOLDER_MODE,
    ) -> None:
        """Create the first part.

        Args:
            path: the file; with `split_bytes` or `split_seconds`, parts are named `NAME_000.mcap`, `NAME_001.mcap`, ...
            metadata: the first record of every part.
            compression: of small messages; those above 32 KiB (camera pictures) use `lz4` in chunks of their own, and are stored
                as they are where that gains nothing; `none` holds for all.
            chunk_size: bytes of messages compressed together.
            split_bytes: begin a new part when one has this size.
            split_seconds: begin a new part after this time (of the log).
            viewer: `vantage.log.viewer.Viewer(...).translate`, to write channels for Foxglove and Lichtblick beside.
            sync: call fdatasync with every flush.
            flush_period: ns.
            keep_going: count what the disk refuses instead of raising; the folder is made when it is missing.
            file_mode, folder_mode: of new files and folders, which the umask narrows further.

        Raises:
            FileExistsError: a log is never overwritten.
            OSError: the file cannot be created (not with `keep_going`).
        """
        self.path = path
        self.error: str | None = None
        self.displaced = ""
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
        self._keep_going = keep_going
        self._file_mode, self._folder_mode = file_mode, folder_mode
        self._splits = split_bytes is not None or split_seconds is not None
        self._part_number = 0
        self._last_time = 0
        self._gap_sequence = 0
        self._losses = Losses()
        self._latched: dict[Name, tuple[bytes, int, int]] = {}
        self._retry_at = 0
        self._failed = self._wrote = False  # since the last flush
        self._thread = SyncThread()
        self._closed = False
        self._synced: tuple[Part, int] | None = None
        self._part_start: int | None = None
        self._cannot_grow = False
        self._begin(self._next_part())
        self._try_open()
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
    def gaps(self) -> dict[Name, int]:
        """(topic, publisher) -> messages that the log lacks: lost before they came here, or dropped."""
        return self._losses.all

    @property
    def dropped(self) -> dict[Name, int]:
        """(topic, publisher) -> messages that came here and are not in the log."""
        return self._losses.dropped

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

        Raises:
            OSError: the disk refuses (not with `keep_going`).
        """
        if self._is_full(log_time):
            self.split()
        if log_time <= self._last_time:
            log_time = self._last_time + 1
        self._last_time = log_time
        if self._part_start is None:
            self._part_start = log_time
        route = self._routes.of(key, publisher, well_formed)
        if not well_formed:
            self.malformed += 1
        elif key not in TOPICS:
            self.undeclared += 1
        self._put(route, sequence, log_time, publish_time, payload)
        if route.latched and (len(self._latched) < MOST_NAMES or (key, publisher) in self._latched):
            self._latched[key, publisher] = (payload, publish_time, sequence)
        if self._viewer is not None and well_formed:
            for message in self._viewer(key, payload):
                self._put(self._routes.of_viewer(message), 0, log_time, publish_time, message.payload)
        if time.monotonic_ns() - self._flushed_at >= self._flush_period:
            self.flush(wait=False)

    def gap(self, key: str, publisher: str, missed: int, *, log_time: int = 0) -> None:
        """Note that messages were lost before they came here: in the log (topic `gap`) and in the part's metadata."""
        self._losses.note((key, publisher), missed)
        self._put_note(key, publisher, missed, log_time)

    def flush(self, wait: bool = True) -> None:
        """Put everything that waits into the file, and (with `sync`) onto the disk.

        Args:
            wait: return when the disk has it; else fdatasync goes on in its thread.

        Raises:
            OSError: the disk refuses (not with `keep_going`).
        """
        self._flushed_at = time.monotonic_ns()
        if how := self._part.displaced:
            self._replace_displaced(how)
        failed_before, self._failed = self._failed, False
        self._try_open()
        self._write_chunks(self._part)
        wrote = self._wrote  # messages; a note may fit where they do not
        if not self._failed:
            for (key, publisher), missed in self._losses.notes_due():
                self._put_note(key, publisher, missed)
            self._write_chunks(self._part)
        if wrote and not (self._failed or failed_before) and has_room(self._part.path.parent, self._chunk_size):
            self.error = None
        self._failed = self._wrote = False
        if self._sync and self._part.is_open and self._synced != (self._part, self._part.size):
            if wait or self._thread.idle:
                self._note_sync_errors()
                self._synced = (self._part, self._part.size)
                self._thread.submit(self._part.sync)
            if wait:
                self._note_sync_errors()

    def split(self) -> None:
        """Begin a new part: the next file is open before the present one is closed.

        Raises:
            OSError: the disk refuses (not with `keep_going`: then the present part goes on).
        """
        before = self._part
        self._write_chunks(before)
        after = self._next_part()
        try:
            self._open(after)
        except OSError as error:
            self._retry_at = self._last_time + _RETRY_PERIOD
            self._fail(after, error)
            return
        gaps = self._losses.take_delivered()
        self._begin(after)
        before.add_metadata(NEXT, {PART: str(self._part_number - 1)})
        self._finish(before, gaps)

    def close(self) -> None:
        """Write what waits, finish the file and close it. Calling it again does nothing.

        Raises:
            OSError: the disk refuses (not with `keep_going`).
        """
        if self._closed:
            return
        self._closed = True
        try:
            self.flush(wait=False)
            gaps = self._losses.take_delivered()
            for name, missed in self._losses.owed.items():  # no room for the notes; the summary may find some
                add_to(gaps, name, missed)
            self._finish(self._part, gaps)
            self._note_sync_errors()
        finally:
            self._thread.end()
            self._part.close()

    def __enter__(self) -> LogWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            with suppress(OSError):  # the error on its way says more
                self.close()

    def _is_full(self, log_time: int) -> bool:
        if self._part_start is None or log_time < self._retry_at or not self._part.is_open:
            return False
        if self._cannot_grow:
            return True
        if not self._splits:
            return False
        if self._split_time is not None and log_time - self._part_start >= self._split_time:
            return True
        if self._part.chunk_count >= MOST_CHUNKS:
            return True
        return self._split_bytes is not None and self._part.size + self._part.pending >= self._split_bytes

    def _next_part(self) -> Part:
        number = self._part_number
        is_part = self._splits or number > 0
        path = part_path(self.path, number) if is_part else self.path
        part = Part(path, self._chunk_size, mode=self._file_mode, durable=self._sync)
        part.add_metadata(RUN, {**self._metadata, PART: str(number)} if is_part else self._metadata)
        return part

    def _begin(self, part: Part) -> None:
        """Make a part the present one, and repeat the latched topics in it."""
        self._part: Part = part
        self._part_number += 1
        self._part_start = None
        self._cannot_grow = False
        self._routes: Routes = Routes(part, self._compression)
        for (key, publisher), (payload, publish_time, sequence) in self._latched.items():
            self._last_time += 1
            self._put(self._routes.repeated(key, publisher), sequence, self._last_time, publish_time, payload)

    def _open(self, part: Part) -> None:
        if self._keep_going and not part.is_open:
            # Where a link leads that points nowhere, too.
            Path(os.path.realpath(part.path.parent)).mkdir(self._folder_mode, parents=True, exist_ok=True)
        part.open()

    def _try_open(self) -> None:
        if self._part.is_open:
            return
        try:
            self._open(self._part)
        except OSError as error:
            self._fail(self._part, error)

    def _put_note(self, key: str, publisher: str, missed: int, log_time: int = 0) -> None:
        self._last_time = log_time = max(log_time, self._last_time + 1)
        if self._part_start is None:
            self._part_start = log_time
        note = encode(Gap(stamp=log_time, key=key[:200], publisher=publisher[:200], missed=missed))
        self._gap_sequence += 1
        self._put(self._routes.of(*NOTES, True), self._gap_sequence, log_time, log_time, note)

    def _put(self, route: Route, sequence: int, log_time: int, publish_time: int, payload: bytes) -> None:
        group, compression = "", route.compression
        if len(payload) >= _BULKY:
            group, compression = route.bulk_group, route.bulk_compression
        self.message_count += 1
        if self._part.add_message(route.channel, group, compression, sequence, log_time, publish_time, payload):
            self._write_chunk(self._part, group)

    def _write_chunks(self, part: Part) -> None:
        for group in part.groups:
            self._write_chunk(part, group)

    def _write_chunk(self, part: Part, group: str) -> None:
        try:
            written = part.write_chunk(group)
        except ChunkLost as lost:
            self._losses.drop(lost.dropped)
            if group == "":  # where the notes are
                self._losses.chunk_lost()
            self._cannot_grow |= lost.error.errno == errno.EFBIG
            self._fail(part, lost.error)
        else:
            self._wrote |= written
            if written and group == "":
                self._losses.chunk_written()

    def _replace_displaced(self, how: str) -> None:
        """Begin a new part, because the present one's file was deleted or moved; what was in a deleted one is lost."""
        before = self._part
        if not self._keep_going:
            raise FileNotFoundError(errno.ENOENT, f"the file was {how} while it was being written", str(before.path))
        self._write_chunks(before)
        lost = ""
        if how == "deleted":
            lost = f" with {counted(self._losses.drop(before.counts), 'message')}"
            self._losses.part_lost()
        gaps = self._losses.take_delivered()
        self._begin(self._next_part())
        self.displaced = f"{before.path} was {how}{lost} while it was being written; the log goes on in {self._part.path.name}"
        if how == "moved":
            self._finish(before, gaps)
        else:
            self._thread.after(before.close)

    def _note_sync_errors(self) -> None:
        for error in self._thread.finish():
            self._fail(self._part, error)

    def _fail(self, part: Part, error: OSError) -> None:
        self._failed = True
        self.error = self._losses.reason(part.path, part.is_open, error)
        if not self._keep_going:
            raise OSError(error.errno, os.strerror(error.errno or errno.EIO), str(part.path)) from error

    def _finish(self, part: Part, gaps: dict[Name, int]) -> None:
        if gaps:
            part.add_metadata(GAPS, {f"{key} {publisher}": str(missed) for (key, publisher), missed in gaps.items()})
        try:
            part.finish()
        except OSError as error:
            self._fail(part, error)
        finally:
            if self._sync:
                self._thread.submit(part.sync)
            self._thread.after(part.close)
