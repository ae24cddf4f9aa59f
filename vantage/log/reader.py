"""Reading logs: whole, in several parts, or broken off; fast, in the order in which they were recorded."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
from mcap.records import Channel

from schemas import TOPICS, MalformedMessage, Message, decode
from vantage.errors import UserError
from vantage.log.file import LogFile, first_metadata
from vantage.log.metadata import EXPORTED, GAPS, NEXT, PART, REPEATED, RUN, VIEWER_PREFIX
from vantage.log.names import part_path, run_and_number

MOST_LISTED = 20
"""Logs or games that an error lists."""
_MOST_OPEN = 100
"""Parts of one log that are open at once: the system limits open files."""


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
        missing: parts that are not there, a line for each run of them.
    """

    files: list[LogFile] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)

    @property
    def breaks(self) -> list[str]:
        """What is missing, and `file: what could not be read`; complete once the records have been gone through."""
        return self.missing + [f"{file.path.name}: {text}" for file in self.files for text in file.breaks]

    @property
    def recording(self) -> bool:
        """Whether the log is being recorded now."""
        return any(file.recording for file in self.files)

    @property
    def finished(self) -> bool:
        """Whether every part was closed properly."""
        return all(file.finished for file in self.files)

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
                if count.isdecimal() and len(count) < 20:  # else another program wrote it
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
            self.release(file)

    def release(self, file: LogFile) -> None:
        """Close a part that has been gone through, where the log has too many for all of them to stay open."""
        if len(self.files) > _MOST_OPEN:
            file.close()

    def close(self) -> None:
        """Let go of the files."""
        for file in self.files:
            file.close()

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def find_logs(source: Path) -> list[list[Path]]:
    """Return the logs below `source`, each as the list of its parts, in order.

    Args:
        source: a file, or a folder that is searched with its subfolders. Files `RUN_000.mcap`, `RUN_001.mcap`, ... that were
            written as parts of one run are one log. In a folder, hidden files and copies for viewers (`vantage log export`) are
            no logs.

    Raises:
        NoSuchLog: there is none.
    """
    if source.is_file():
        return [[source]]
    logs: dict[tuple[Path, str], list[tuple[int, Path]]] = {}
    for path in sorted(source.rglob("*.mcap")):
        if any(name.startswith(".") for name in path.relative_to(source).parts):
            continue
        metadata = first_metadata(path)
        if EXPORTED in metadata:
            continue
        run, number = _place_of(path, metadata)
        logs.setdefault((run, metadata.get("started", "")), []).append((number, path))
    if not logs:
        raise NoSuchLog(f"{source}: no log (*.mcap) there")
    return [parts for numbered in logs.values() for parts in _apart(numbered)]


def _place_of(path: Path, metadata: dict[str, str]) -> tuple[Path, int]:
    """Return the run that a file belongs to, and its number in it: -1 for a file that was begun as a log in one file."""
    place = run_and_number(path) if PART in metadata else None
    return place or (path.with_name(path.stem), -1)


def _apart(numbered: list[tuple[int, Path]]) -> list[list[Path]]:
    """Return the files of one name as logs: a log in one file is a log of its own where there is a first part, too."""
    numbered.sort()
    if len(numbered) > 1 and numbered[0][0] == -1 and numbered[1][0] == 0:
        return [[numbered[0][1]], [path for _, path in numbered[1:]]]
    return [[path for _, path in numbered]]


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
    metadata = first_metadata(run)
    place = run_and_number(run)
    if place is None or PART not in metadata:
        return [run]
    parts = sorted(
        (found[1], path)
        for path in run.parent.glob("*.mcap")
        if (found := run_and_number(path)) is not None
        and found[0] == place[0]
        and PART in (other := first_metadata(path))
        and other.get("started") == metadata.get("started")
    )
    paths = [path for _, path in parts]
    if paths[0] != run:
        raise NoSuchLog(f"{run.name} is part {paths.index(run) + 1} of a log: name its first part, {paths[0]}")
    return paths


def _size(parts: list[Path]) -> str:
    size = f"{sum(path.stat().st_size for path in parts) / 1e6:.1f} MB"
    return size if len(parts) == 1 else f"{size} in {len(parts)} parts"


def open_log(*parts: Path) -> Log:
    """Return the log that consists of these parts.

    Raises:
        OSError: a part cannot be opened.
    """
    log = Log()
    for path in parts:
        file = LogFile(path)
        log.files.append(file)
        if len(parts) > _MOST_OPEN:
            file.close()
    log.missing = _missing(log.files)
    return log


def _missing(files: list[LogFile]) -> list[str]:
    """Return the parts that lie neither in the log nor beside it."""
    expected, gone = 0, []
    for file in files:
        run, number = _place_of(file.path, file.metadata.get(RUN, {}))
        if number > expected and not part_path(run, expected).exists():
            gone.append((run, expected, number - 1))
        expected = max(number, 0) + 1
        if file is files[-1] and number >= 0 and NEXT in file.metadata and not part_path(run, expected).exists():
            gone.append((run, expected, expected))
    return [
        f"{part_path(run, first).name} is missing"
        if first == last
        else f"{part_path(run, first).name} to {part_path(run, last).name} are missing"
        for run, first, last in gone
    ]


def read(source: Path, topics: Collection[str] | None = None, viewer: bool = False) -> Iterator[Record]:
    """Yield the messages of a log in the order in which they were recorded.

    A log that was cut short or damaged yields what is whole and then warns with `BrokenLog`, which names the place.

    Args:
        source: a file, or a folder; of several logs in a folder, one comes after the other.
        topics: only these keys; the rest is not even decompressed where it lies in chunks of its own.
        viewer: also the channels for Foxglove and Lichtblick (keys `viewer/...`).

    Raises:
        NoSuchLog: there is none.
        OSError: a file cannot be opened.
    """
    for parts in find_logs(source):
        with open_log(*parts) as log:
            yield from log.records(topics, viewer)
            for text in log.breaks:
                warnings.warn(text, BrokenLog, stacklevel=2)
