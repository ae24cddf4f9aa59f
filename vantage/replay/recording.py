"""A log as a replay needs it: its games, what was recorded after a moment, and how everything stood at one.

Nothing but the referee's words is held in memory: chunks are read when their turn comes, and a moment is found by the chunks'
times and channels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from schemas import MalformedMessage, PredictRequest, decode
from vantage.log.file import Chunk, LogFile
from vantage.log.games import WORD_TOPICS, Game, games_of
from vantage.log.metadata import REPEATED, VIEWER_PREFIX
from vantage.log.reader import MOST_LISTED, Log, NoSuchLog, Record, open_log, parts_of
from vantage.replay.trouble import ReplayError

__all__ = ["MOST_LISTED", "Game", "Recording", "find_parts", "games_of"]


class Recording:
    """See the module.

    Attributes:
        name: of the log, for people.
        start, end: log times of the first and the last message, ns.
        games: that can be joined, in order.
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
        chunks = [(file, chunk) for file in self._log.files for chunk in file.chunks if chunk.end]  # 0: it is empty
        times = [(chunk.start, chunk.end) for file, chunk in chunks if self._ids_in(file, chunk)]
        self.start = min((start for start, _ in times), default=0)
        self.end = max((end for _, end in times), default=0)
        if not times:
            why = "; ".join(self._log.breaks) or "it holds no message"
            self.close()
            raise ReplayError(f"{parts[0]}: nothing to replay: {why}")

        def watched() -> Iterator[Record]:
            for record in self._log.records(WORD_TOPICS):
                progress((record.log_time - self.start) / max(self.end - self.start, 1))
                yield record

        # An end alone, of a game from before the log began, is nothing to jump to.
        self.games = [game for game in games_of(watched()) if game.words[0].said.phase in ("setup", "running")]
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
        """Return key -> the last message that was recorded at `position` (ns) or before; malformed ones hide none."""
        found: dict[str, Record] = {}
        for file in reversed(self._log.files):
            chunks = [chunk for chunk in file.chunks if chunk.start <= position]
            for chunk in sorted(chunks, key=lambda chunk: chunk.end, reverse=True):
                channels = {id: file.channels[id] for id in self._ids_in(file, chunk)}
                keys = {id: channel.topic for id, channel in channels.items() if channel.message_encoding}
                wanted = {id for id, key in keys.items() if key not in found or found[key].log_time < min(chunk.end, position)}
                if not wanted:
                    continue
                for id, sequence, log_time, publish_time, payload in file.messages_of(chunk):
                    if id in wanted and log_time <= position and _says_how_it_stands(keys[id], payload):
                        known = found.get(keys[id])
                        if known is None or known.log_time < log_time:
                            publisher = channels[id].metadata.get("publisher", "")
                            found[keys[id]] = Record(keys[id], publisher, sequence, log_time, publish_time, payload)
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
    try:
        return parts_of(run)
    except NoSuchLog as error:
        raise ReplayError(str(error)) from None
