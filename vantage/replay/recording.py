"""A log as a replay needs it: its games, what was recorded after a moment, and how everything stood at one.

Nothing but the referee's words is held in memory: chunks are read when their turn comes, and a moment is found by the chunks'
times and channels.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from schemas import Episode, MalformedMessage, PredictRequest, decode
from vantage.log.file import Chunk, LogFile, first_metadata
from vantage.log.metadata import PART, REPEATED, VIEWER_PREFIX
from vantage.log.reader import Log, Record, find_logs, open_log
from vantage.replay.trouble import ReplayError

MOST_LISTED = 20
"""Logs or games that an error lists."""


@dataclass(frozen=True, slots=True)
class Word:
    """Something the referee said of a game, at a log time (ns)."""

    time: int
    publisher: str
    said: Episode


@dataclass(slots=True)
class Game:
    """One game of a log.

    Attributes:
        words: of the referee, in order; the first is the set-up, unless the log begins within the game.
        since: log time after which messages of this number belong to this game and not to an earlier one, ns.
    """

    words: list[Word] = field(default_factory=list)
    since: int = -1

    @property
    def number(self) -> int:
        return self.words[0].said.episode

    @property
    def start(self) -> int:
        """Log time of the first word, ns."""
        return self.words[0].time


def games_of(records: Iterator[Record]) -> list[Game]:
    """Return the games that the referee speaks of, in the order of their first words.

    A set-up begins a game, also one whose number was there before; a word on a number that was never set up does if that game
    is running (the log begins within it).
    """
    games: list[Game] = []
    latest: dict[int, Game] = {}
    for record in records:
        try:
            said = record.decode()
        except MalformedMessage:
            continue
        if not isinstance(said, Episode):
            continue
        word = Word(record.log_time, record.publisher, said)
        if said.phase == "setup" or (said.phase == "running" and said.episode not in latest):
            since = games[-1].words[-1].time if games else -1
            games.append(Game([word], since))
            latest[said.episode] = games[-1]
        elif said.episode in latest:
            latest[said.episode].words.append(word)
    return games


class Recording:
    """See the module.

    Attributes:
        name: of the log, for people.
        start, end: log times of the first and the last message, ns.
        games: in order.
        publishers: the (key, publisher) pairs of the log.
    """

    def __init__(self, *parts: Path, progress: Callable[[float], None] = lambda part: None) -> None:
        """Open a log and look for its games.

        Args:
            parts: its files, in order.
            progress: told how much of the log has been looked through, 0..1.

        Raises:
            ReplayError: nothing can be read from it.
            OSError: a file cannot be opened.
        """
        self.name = parts[0].stem
        self._log: Log = open_log(*parts)
        times = [(chunk.start, chunk.end) for file in self._log.files for chunk in file.chunks if self._ids_in(file, chunk)]
        self.start = min((start for start, _ in times), default=0)
        self.end = max((end for _, end in times), default=0)
        if not times:
            why = "; ".join(self._log.breaks) or "it holds no message"
            self.close()
            raise ReplayError(f"{parts[0]}: nothing to replay: {why}")

        def watched() -> Iterator[Record]:
            for record in self._log.records({"episode"}):
                progress((record.log_time - self.start) / max(self.end - self.start, 1))
                yield record

        self.games = games_of(watched())
        self.publishers = {
            (channel.topic, channel.metadata.get("publisher", ""))
            for file in self._log.files
            for channel in file.channels.values()
            if not channel.topic.startswith(VIEWER_PREFIX)
        }

    @property
    def breaks(self) -> list[str]:
        """What could not be read so far, a line each."""
        return self._log.breaks

    def records(self, after: int) -> Iterator[Record]:
        """Yield what was recorded after a log time (ns), in order."""
        return self._log.records(after=after)

    def latest(self, position: int) -> dict[str, Record]:
        """Return key -> the last message that was recorded at `position` (ns) or before."""
        found: dict[str, Record] = {}
        for file in reversed(self._log.files):
            chunks = [chunk for chunk in file.chunks if chunk.start <= position]
            for chunk in sorted(chunks, key=lambda chunk: chunk.end, reverse=True):
                keys = {id: file.channels[id].topic for id in self._ids_in(file, chunk)}
                wanted = {id for id, key in keys.items() if key not in found or found[key].log_time < min(chunk.end, position)}
                if not wanted:
                    continue
                for id, sequence, log_time, publish_time, payload in file.messages_of(chunk):
                    if id in wanted and log_time <= position and _says_how_it_stands(keys[id], payload):
                        known = found.get(keys[id])
                        if known is None or known.log_time < log_time:
                            channel = file.channels[id]
                            publisher = channel.metadata.get("publisher", "")
                            well_formed = channel.message_encoding != ""
                            found[keys[id]] = Record(keys[id], publisher, sequence, log_time, publish_time, payload, well_formed)
        return found

    def close(self) -> None:
        """Let go of the files."""
        self._log.close()

    def _ids_in(self, file: LogFile, chunk: Chunk) -> set[int]:
        """The channels of a chunk that count: not the viewers', and not what a later part repeats of the one before."""
        held = file.channels.keys() if chunk.channels is None else chunk.channels & file.channels.keys()
        first = file is self._log.files[0]
        return {
            id
            for id in held
            if not file.channels[id].topic.startswith(VIEWER_PREFIX) and (first or REPEATED not in file.channels[id].metadata)
        }


def _says_how_it_stands(key: str, payload: bytes) -> bool:
    """Whether a message is of use to who joins after it: not a viewer's question about one goal, which hides the planner's."""
    if key != "predictor/request":
        return True
    try:
        return not decode(PredictRequest, payload).views
    except MalformedMessage:
        return False


def find_parts(run: Path) -> list[Path]:
    """Return the files of the log that `run` names: a file, the first part of several, or a folder with one log.

    Raises:
        ReplayError: there is none, there are several, or it is a later part.
    """
    if run.is_dir():
        try:
            logs = find_logs(run)
        except FileNotFoundError as error:
            raise ReplayError(str(error)) from None
        if len(logs) > 1:
            listed = "\n".join(f"  {parts[0]}  {_size(parts)}" for parts in logs[:MOST_LISTED])
            more = f"\n  and {len(logs) - MOST_LISTED} more" if len(logs) > MOST_LISTED else ""
            raise ReplayError(f"{run} holds {len(logs)} logs; name one of them:\n{listed}{more}")
        return logs[0]
    if not run.is_file():
        raise ReplayError(f"{run}: there is no such log or folder")
    part = re.fullmatch(r"(.+)_\d{3,}", run.stem)
    if part is None or PART not in first_metadata(run):
        return [run]
    parts = sorted(path for path in run.parent.glob("*.mcap") if re.fullmatch(re.escape(part[1]) + r"_\d{3,}", path.stem))
    if parts[0] != run:
        raise ReplayError(f"{run.name} is part {parts.index(run) + 1} of a log: name its first part, {parts[0]}")
    return parts


def _size(parts: list[Path]) -> str:
    size = f"{sum(path.stat().st_size for path in parts) / 1e6:.1f} MB"
    return size if len(parts) == 1 else f"{size} in {len(parts)} parts"
