"""Puts what is said on the bus into a log, byte for byte. The one core that does I/O: writing files is its behaviour."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal

from schemas import TOPICS, Gap, MalformedMessage
from services.recorder.appearance import arena_appearance
from services.recorder.declaration import DECLARATION
from vantage.bus import Lost, Sample
from vantage.log import LogWriter, RunMetadata, source_commit
from vantage.log.compression import Compression
from vantage.log.viewer import Viewer
from vantage.service import Publish, Received, Send

logger = logging.getLogger("vantage")

FLUSH_PERIOD = 1_000_000_000
"""ns: what a crash costs at most."""
DISPLACED_LASTS = 10 * FLUSH_PERIOD
"""ns that health repeats that a log file was deleted or moved."""
MODES = {"owner": (0o600, 0o700), "group": (0o640, 0o750), "everyone": (0o644, 0o755)}
"""Who may read -> modes of new files and folders."""


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
    readable_by: Literal["owner", "group", "everyone"] = "group"
    """Who may read new logs (and list new folders): logs may hold names of people who played. Your umask may narrow it."""


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
        """Open the log: as soon as there is room for it, when the disk refuses now.

        Args:
            settings: where and how.
            arena: name of the arena.
            deployment: the text of the deployment's configuration, empty when there is none.
            now: ns since the Unix epoch.
        """
        configuration = json.dumps({"recorder": asdict(settings), "deployment": deployment}, default=os.fspath)
        metadata = RunMetadata(
            commit=source_commit(),
            configuration=configuration,
            weights=weights_hash(settings.weights),
            arena=arena,
            started=now,
        )
        file_mode, folder_mode = MODES[settings.readable_by]
        self.writer = LogWriter(
            log_path(settings.logs, arena, now),
            metadata,
            compression=settings.compression,
            split_bytes=None if settings.split_megabytes is None else int(settings.split_megabytes * 1e6),
            split_seconds=None if settings.split_minutes is None else 60 * settings.split_minutes,
            viewer=Viewer(arena_appearance(), settings.viewer_rate).translate if settings.viewer else None,
            keep_going=True,
            file_mode=file_mode,
            folder_mode=folder_mode,
        )
        self._flush_at = now + FLUSH_PERIOD
        self._announced: dict[tuple[str, str], int] = {}
        self._flushed = False  # since losses were announced
        self._displaced, self._displaced_until = "", 0
        self._logged = ""
        self._log_trouble()

    @property
    def trouble(self) -> str:
        """What keeps the recorder from recording, for health; empty when nothing does."""
        return self.writer.error or self._displaced

    def step(self, received: Received, now: int) -> Sequence[Send]:
        """Write a message, note a loss; and whatever wakes it, flush when it is time.

        Raises:
            MalformedMessage: the bytes are recorded, but are no message of their topic.
        """
        sends: list[Send] = []
        try:
            if isinstance(received, Sample):
                self._write(received, now)
            elif isinstance(received, Lost):
                self.writer.gap(received.key, received.publisher, received.missed, log_time=now)
                sends.append(_gap(received.key, received.publisher, received.missed, now))
        finally:
            if now >= self._flush_at:
                self._flush_at = now + FLUSH_PERIOD
                self.writer.flush(wait=False)
                self._look_at_writer(now)
        return sends + self._new_losses(now) if self._flushed else sends

    def wake_at(self) -> int | None:
        """The next flush."""
        return self._flush_at

    def close(self) -> None:
        """Finish the log; one without a message leaves no file."""
        self.writer.close()
        if not self.writer.message_count:
            self.writer.part.unlink(missing_ok=True)

    def _look_at_writer(self, now: int) -> None:
        if self.writer.displaced and self._displaced_until == 0:
            self._displaced, self._displaced_until = self.writer.displaced, now + DISPLACED_LASTS
            self.writer.displaced = ""
        elif now >= self._displaced_until:
            self._displaced, self._displaced_until = "", 0
        self._log_trouble()
        self._flushed = True

    def _log_trouble(self) -> None:
        """Put a new trouble, and its end, into the service's own log: not each count of what was dropped."""
        trouble = self.trouble.partition("; messages dropped")[0]
        if trouble != self._logged:
            logger.warning("recorder: %s", self.trouble or "the log is being written again")
            self._logged = trouble

    def _new_losses(self, now: int) -> list[Send]:
        """Return a gap for every topic and publisher of which the disk has refused messages since the last call."""
        self._flushed = False
        dropped = self.writer.dropped
        if sum(dropped.values()) == sum(self._announced.values()):
            return []
        lost = {name: count - self._announced.get(name, 0) for name, count in dropped.items()}
        self._announced = dict(dropped)
        return [_gap(*name, missed, now) for name, missed in lost.items() if missed]

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


def _gap(key: str, publisher: str, missed: int, now: int) -> Publish:
    return Publish("gap", Gap(stamp=now, key=key[:200], publisher=publisher[:200], missed=missed))
