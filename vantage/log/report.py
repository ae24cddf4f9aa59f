"""What is in a log, for people."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from rich.box import SIMPLE
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from schemas import Control, Episode, Gap, MalformedMessage, Pose
from vantage.log.games import AboutGame, Games, Word
from vantage.log.reader import Record, find_logs, open_log
from vantage.printable import counted, printable

_LONGEST_NAME = 200
_LONGEST_VALUE = 300
"""Letters of a topic, and of a piece of metadata, that are shown."""


@dataclass
class TopicReport:
    """What one publisher said on one topic.

    Attributes:
        count, size: messages and their bytes.
        first_time, last_time: log times, ns since the Unix epoch.
        missing: messages that are not in the log, by the publisher's sequence numbers.
        malformed: bytes that did not decode as the topic's type.
    """

    count: int = 0
    size: int = 0
    first_time: int = 0
    last_time: int = 0
    missing: int = 0
    malformed: int = 0
    _sequence: int | None = None

    @property
    def rate(self) -> float:
        """Messages a second, 0 when it cannot be told."""
        span = self.last_time - self.first_time
        return (self.count - 1) * 1e9 / span if span > 1_000_000 else 0.0

    def add(self, record: Record) -> None:
        """Count a message. A sequence number that goes back is a publisher that started again, not a gap."""
        if self._sequence is not None and record.sequence > self._sequence + 1:
            self.missing += record.sequence - self._sequence - 1
        self._sequence = record.sequence
        if not self.count:
            self.first_time = record.log_time
        self.last_time = record.log_time
        self.count += 1
        self.size += len(record.payload)
        self.malformed += not record.well_formed


@dataclass
class GameReport(AboutGame):
    """One game: what the referee said of it, and the steps seen."""

    steps: int = 0

    @property
    def driver(self) -> str:
        """Who drove the hider; with the name or pseudonym of the person where it is stored."""
        players = self.episode.players
        return f"{players.hider} ({players.person})" if players.person else players.hider

    @property
    def phase(self) -> str:
        """How far the game came, and what became of it."""
        paused = ", paused" if self.episode.paused and self.episode.phase == "running" else ""
        return f"{self.episode.phase}{paused}{', discarded' if self.discarded else ''}"


@dataclass
class LogReport:
    """What is in a log; print it with rich.

    Attributes:
        parts: the files.
        metadata: of the run.
        topics: (key, publisher) -> what was said.
        games: in order.
        gaps: `key publisher` -> messages that the recorder noted as lost.
        breaks: what could not be read.
        finished: whether every part was closed properly.
        recording: whether the log is being recorded now.
    """

    parts: list[Path]
    metadata: dict[str, str]
    topics: dict[tuple[str, str], TopicReport] = field(default_factory=dict)
    games: list[GameReport] = field(default_factory=list)
    gaps: dict[str, int] = field(default_factory=dict)
    breaks: list[str] = field(default_factory=list)
    finished: bool = True
    recording: bool = False
    _heard: Games = field(default_factory=Games)

    @property
    def count(self) -> int:
        """Messages."""
        return sum(topic.count for topic in self.topics.values())

    @property
    def duration(self) -> float:
        """Seconds from the first message to the last."""
        if not self.topics:
            return 0.0
        first = min(topic.first_time for topic in self.topics.values())
        return (max(topic.last_time for topic in self.topics.values()) - first) / 1e9

    def add(self, record: Record) -> None:
        """Take a message into account."""
        topic = self.topics.get((record.key, record.publisher))
        if topic is None:
            topic = self.topics[record.key, record.publisher] = TopicReport()
        topic.add(record)
        if record.key not in ("episode", "gap", "control", "hider/pose"):
            return
        try:
            message = record.decode()
        except MalformedMessage:
            return
        if isinstance(message, Episode):
            game = self._heard.hear(Word(record.log_time, record.publisher, message))
            if game is not None and game.place == len(self.games):
                self.games.append(GameReport(game))
        elif isinstance(message, Control):
            self._heard.heed(record.log_time, message)
        elif isinstance(message, Gap):
            name = f"{message.key} {message.publisher}".rstrip()
            self.gaps[name] = self.gaps.get(name, 0) + message.missed
        elif isinstance(message, Pose):
            owner = self._heard.owner(message.episode)
            if owner is not None:
                self.games[owner.place].steps = max(self.games[owner.place].steps, message.step)

    def __rich__(self) -> RenderableType:
        shown: list[RenderableType] = [self._summary(), self._topic_table()]
        if self.games:
            shown.append(self._game_table())
        if self.gaps:
            lost = ", ".join(f"{missed} of {name}" for name, missed in sorted(self.gaps.items()))
            shown.append(_as_written("lost: " + lost, 10_000))
        shown += [_as_written(text, 1000, "yellow") for text in self.breaks]
        return Group(*shown)

    def _summary(self) -> Table:
        table = Table.grid(padding=(0, 2))
        size = sum(path.stat().st_size for path in self.parts)
        names = str(self.parts[0])
        if len(self.parts) > 1:
            names += f" and {counted(len(self.parts) - 1, 'more part')}"
        if self.recording:
            names += " (being recorded now)"
        elif not self.finished:
            names += " (not closed: `vantage log recover` makes it whole)"
        table.add_row("log", _as_written(names, 5000))
        messages = counted(self.count, "message")
        table.add_row("content", f"{messages}, {self.duration:.1f} s, {size / 1e6:.2f} MB, {sum(self.gaps.values())} lost")
        for name, value in self.metadata.items():
            if name == "started":
                value = _as_time(value)
            table.add_row(_as_written(name.replace("_", " "), _LONGEST_NAME), _as_written(value, _LONGEST_VALUE))
        return table

    def _topic_table(self) -> Table:
        table = Table(box=SIMPLE, padding=(0, 1, 0, 0))  # fits a terminal of 80 columns
        table.add_column("topic", no_wrap=True)
        table.add_column("publisher", no_wrap=True)
        for name in ("messages", "per s", "kB", "missing", "malformed"):
            table.add_column(name, justify="right")
        for (key, publisher), topic in sorted(self.topics.items()):
            numbers = [f"{topic.count}", f"{topic.rate:.2f}" if topic.rate else "", f"{topic.size / 1e3:.1f}"]
            names = (_as_written(key, _LONGEST_NAME), _as_written(publisher, _LONGEST_NAME))
            table.add_row(*names, *numbers, str(topic.missing or ""), str(topic.malformed or ""))
        return table

    def _game_table(self) -> Table:
        table = Table(box=SIMPLE, padding=(0, 1, 0, 0))
        for name in ("game", "seed", "hider", "seeker", "layout", "steps", "phase", "outcome", "reason"):
            table.add_column(name)
        for game in self.games:
            said = game.episode
            names = [str(said.episode), str(said.seed), game.driver, said.players.seeker, said.rules.layout]
            table.add_row(*(_as_written(text) for text in (*names, str(game.steps), game.phase, said.outcome, said.reason)))
        return table


def info(source: Path) -> list[LogReport]:
    """Go through the logs at `source` (a file or a folder) and return a report of each.

    Raises:
        NoSuchLog: no log there.
        OSError: a file cannot be opened.
    """
    reports = []
    for parts in find_logs(source):
        with open_log(*parts) as log:
            report = LogReport(list(parts), log.metadata)
            for record in log.records():
                report.add(record)
            report.breaks = log.breaks
            report.finished, report.recording = log.finished, log.recording
            reports.append(report)
    return reports


def _as_written(text: str, longest: int = 1000, style: str = "") -> Text:
    """Return what others wrote as it is: no markup, and nothing that a terminal obeys."""
    return Text(printable(text, longest), style)


def _as_time(nanoseconds: str) -> str:
    """Return a time as people read it; what is none, as it was written."""
    try:
        moment = datetime.fromtimestamp(int(nanoseconds) / 1e9)
        return moment.astimezone().isoformat(sep=" ", timespec="seconds")
    except (ValueError, OverflowError, OSError):
        return nanoseconds
