"""Reading logs: whole, in several parts, or broken off; fast, in the order in which they were recorded."""

from __future__ import annotations

import re
import warnings
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
from mcap.records import Channel

from schemas import TOPICS, MalformedMessage, Message, decode
from vantage.errors import UserError
from vantage.log.file import LogFile, first_metadata
from vantage.log.metadata import EXPORTED, GAPS, PART, REPEATED, RUN, VIEWER_PREFIX

_PART_NAME = re.compile(r"(.+)_\d{3,}")
MOST_LISTED = 20
"""Logs or games that an error lists."""


class NoSuchLog(UserError):
    """A name does not mean one log; the text says what there is, for people."""


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
        well_formed: false for bytes that the recorder could not decode, or had no type for.
    """

    key: str
    publisher: str
    sequence: int
    log_time: int
    publish_time: int
    payload: bytes
    well_formed: bool = True

    def decode(self) -> Message:
        """Return the message.

        Raises:
            MalformedMessage: the bytes are not a message of the topic's type, or the topic is not in the table.
        """
        topic = TOPICS.get(self.key)
        if topic is None:
            raise MalformedMessage(f"{self.key} is not in the topic table")
        return decode(topic.type, self.payload)


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

    def records(self, topics: Collection[str] | None = None, viewer: bool = False, after: int = -1) -> Iterator[Record]:
        """Yield the messages in order, over all parts; see `read`. With `after` (ns), only those recorded later."""

        def is_wanted(channel: Channel) -> bool:
            named = topics is None or channel.topic in topics
            return named and (viewer or not channel.topic.startswith(VIEWER_PREFIX))

        def is_wanted_and_new(channel: Channel) -> bool:
            return is_wanted(channel) and REPEATED not in channel.metadata

        for file in self.files:
            chosen = is_wanted if file is self.files[0] else is_wanted_and_new
            names: dict[int, tuple[str, str, bool]] = {}
            for id, sequence, log_time, publish_time, payload in file.messages(chosen, after):
                name = names.get(id)
                if name is None:
                    channel = file.channels[id]
                    name = (channel.topic, channel.metadata.get("publisher", ""), channel.message_encoding != "")
                    names[id] = name
                yield Record(name[0], name[1], sequence, log_time, publish_time, payload, name[2])

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
        source: a file, or a folder that is searched with its subfolders. Files `RUN_000.mcap`, `RUN_001.mcap`, ... that were
            written as parts are one log. In a folder, hidden files and copies for viewers (`vantage log export`) are no logs.

    Raises:
        NoSuchLog: there is none.
    """
    if source.is_file():
        return [[source]]
    logs: dict[Path, list[Path]] = {}
    for path in sorted(source.rglob("*.mcap")):
        if any(name.startswith(".") for name in path.relative_to(source).parts):
            continue
        metadata = first_metadata(path)
        if EXPORTED in metadata:
            continue
        run = _PART_NAME.fullmatch(path.stem)
        is_part = run is not None and PART in metadata
        logs.setdefault(path.with_name(run[1]) if run and is_part else path, []).append(path)
    if not logs:
        raise NoSuchLog(f"{source}: no log (*.mcap) there")
    return list(logs.values())


def parts_of(run: Path) -> list[Path]:
    """Return the files of the one log that `run` names: a file, the first part of several, or a folder with one log.

    Raises:
        NoSuchLog: there is none, there are several, or it is a later part.
    """
    if run.is_dir():
        logs = find_logs(run)
        if len(logs) > 1:
            listed = "\n".join(f"  {parts[0]}  {_size(parts)}" for parts in logs[:MOST_LISTED])
            more = f"\n  and {len(logs) - MOST_LISTED} more" if len(logs) > MOST_LISTED else ""
            raise NoSuchLog(f"{run} holds {len(logs)} logs; name one of them:\n{listed}{more}")
        return logs[0]
    if not run.is_file():
        raise NoSuchLog(f"{run}: there is no such log or folder")
    part = _PART_NAME.fullmatch(run.stem)
    if part is None or PART not in first_metadata(run):
        return [run]
    named = re.compile(re.escape(part[1]) + r"_\d{3,}")
    parts = sorted(path for path in run.parent.glob("*.mcap") if named.fullmatch(path.stem) and PART in first_metadata(path))
    if parts[0] != run:
        raise NoSuchLog(f"{run.name} is part {parts.index(run) + 1} of a log: name its first part, {parts[0]}")
    return parts


def _size(parts: list[Path]) -> str:
    size = f"{sum(path.stat().st_size for path in parts) / 1e6:.1f} MB"
    return size if len(parts) == 1 else f"{size} in {len(parts)} parts"


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
