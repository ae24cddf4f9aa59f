"""Puts what is said on the bus into a log, byte for byte. The one core that does I/O: writing files is its behaviour."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from schemas import TOPICS, Gap, MalformedMessage
from services.recorder.appearance import arena_appearance
from services.recorder.declaration import DECLARATION
from vantage.bus import Lost, Sample
from vantage.log import LogWriter, RunMetadata, source_commit
from vantage.log.part import Compression
from vantage.log.viewer import Viewer
from vantage.service import Publish, Received, Send

FLUSH_PERIOD = 1_000_000_000
"""ns: what a crash costs at most."""


@dataclass(frozen=True)
class RecorderSettings:
    """Where and how the log is written."""

    logs: Path = Path("recordings")
    """Folder of the logs; each start of the recorder begins a new one, named by arena and time."""
    viewer: bool = True
    """Write channels for Foxglove, Lichtblick and Rerun beside the originals."""
    viewer_rate: float = 5.0
    """Pictures a second of each camera in those channels, where pictures exceed 256 KiB; the originals are all there."""
    compression: Compression = "zstd"
    """Of small messages; camera pictures above 32 KiB use lz4 where it gains something."""
    weights: Path = Path(__file__).resolve().parents[2] / "weights"
    """Folder of the weights whose hashes the log names."""
    split_megabytes: float | None = 4000.0
    """Begin a new part (NAME_001.mcap) at this size."""
    split_minutes: float | None = None
    """Begin a new part after this time."""


def log_path(folder: Path, arena: str, now: int) -> Path:
    """Return a name in `folder` that no log has yet: the arena and the local time, `table-20261122-141530.mcap`."""
    name = f"{arena}-{datetime.fromtimestamp(now / 1e9):%Y%m%d-%H%M%S}"
    number, path = 1, folder / f"{name}.mcap"
    while any(folder.glob(f"{path.stem}*.mcap")):
        number += 1
        path = folder / f"{name}-{number}.mcap"
    return path


def weights_hash(folder: Path) -> str:
    """Return `name:hash` of every weights file in `folder` (SHA-256, 16 digits), separated by spaces."""
    files = sorted(folder.glob("*.safetensors"))
    return " ".join(f"{path.stem}:{hashlib.sha256(path.read_bytes()).hexdigest()[:16]}" for path in files)


class RecorderCore:
    """See module."""

    declaration = DECLARATION

    def __init__(self, settings: RecorderSettings, arena: str, deployment: str, now: int) -> None:
        """Open the log.

        Args:
            settings: where and how.
            arena: name of the arena.
            deployment: the text of the deployment's configuration, empty when there is none.
            now: ns since the Unix epoch.

        Raises:
            OSError: the folder cannot be made, or the file not be written.
        """
        settings.logs.mkdir(parents=True, exist_ok=True)
        configuration = json.dumps({"recorder": asdict(settings), "deployment": deployment}, default=os.fspath)
        metadata = RunMetadata(
            commit=source_commit(),
            configuration=configuration,
            weights=weights_hash(settings.weights),
            arena=arena,
            started=now,
        )
        self.writer = LogWriter(
            log_path(settings.logs, arena, now),
            metadata,
            compression=settings.compression,
            split_bytes=None if settings.split_megabytes is None else int(settings.split_megabytes * 1e6),
            split_seconds=None if settings.split_minutes is None else 60 * settings.split_minutes,
            viewer=Viewer(arena_appearance(), settings.viewer_rate).translate if settings.viewer else None,
        )
        self._flush_at = now + FLUSH_PERIOD

    @property
    def trouble(self) -> str:
        """What keeps the recorder from recording, for health; empty when nothing does."""
        return self.writer.error or ""

    def step(self, received: Received, now: int) -> Sequence[Send]:
        """Write a message, note a loss; and whatever wakes it, flush when it is time.

        Raises:
            MalformedMessage: the bytes are recorded, but are no message of their topic.
        """
        try:
            if isinstance(received, Sample):
                self._write(received, now)
            elif isinstance(received, Lost):
                self.writer.gap(received.key, received.publisher, received.missed, log_time=now)
                return [Publish("gap", Gap(stamp=now, key=received.key, publisher=received.publisher, missed=received.missed))]
            return []
        finally:
            if now >= self._flush_at:
                self._flush_at = now + FLUSH_PERIOD
                self.writer.flush(wait=False)

    def wake_at(self) -> int | None:
        """The next flush."""
        return self._flush_at

    def close(self) -> None:
        """Finish the log; one without a message leaves no file."""
        self.writer.close()
        if not self.writer.message_count:
            self.writer.part.unlink(missing_ok=True)

    def _write(self, sample: Sample, now: int) -> None:
        topic = TOPICS.get(sample.key)
        if topic is not None and not topic.recorded:
            return
        if sample.key == "gap" and sample.publisher == DECLARATION.name:
            # Its own notes went straight into the log.
            return
        trouble: MalformedMessage | None = None
        try:
            sample.decode()
        except MalformedMessage as error:
            trouble = error
        self.writer.write(
            sample.key,
            sample.payload,
            log_time=now,
            publish_time=sample.published,
            sequence=sample.sequence,
            publisher=sample.publisher,
            well_formed=trouble is None or topic is None,
        )
        if trouble is not None:
            raise trouble
