"""The games in a log."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field

from schemas import (
    ROBOTS,
    ColorImage,
    Command,
    Control,
    DepthImage,
    Episode,
    Gap,
    Layout,
    Message,
    Plan,
    Pose,
    Robot,
    StateImage,
    Tick,
)
from vantage.log.games import WORD_TOPICS, Games, messages_of
from vantage.log.games import games_of as heard
from vantage.log.reader import Log, Record

EPISODE_TOPICS: frozenset[str] = frozenset(
    {"episode", "tick", "layout", "gap", "control", "hider/plan"}
    | {f"{robot}/{name}" for robot in ROBOTS for name in ("pose", "depth", "color", "command", "view")}
)
"""What `episodes` looks at: hand it to `read` as the topics."""


@dataclass
class EpisodeLog:
    """One game, as far as the log has it. Everything by step; a dictionary lacks the steps that were not recorded.

    Attributes:
        episode: the last word of the referee: phase `ended` or `aborted`, or how far it had come when the log stopped (within a
            pause: `running` and `paused`).
        place: among the games of the log, from 0.
        layout: None when the log lacks it.
        poses, depths, colors, commands, views: robot -> step -> message.
        plans: step -> message.
        ticks: in order.
        late: step -> robots that stayed because their command did not come in time.
        lost: messages the recorder knows it missed during this game.
        malformed: messages of the game that did not decode.
        discarded: somebody said later (`control`) that the game is not to be used as data.
    """

    episode: Episode
    place: int = 0
    layout: Layout | None = None
    poses: dict[Robot, dict[int, Pose]] = field(default_factory=lambda: {robot: {} for robot in ROBOTS})
    depths: dict[Robot, dict[int, DepthImage]] = field(default_factory=lambda: {robot: {} for robot in ROBOTS})
    colors: dict[Robot, dict[int, ColorImage]] = field(default_factory=lambda: {robot: {} for robot in ROBOTS})
    commands: dict[Robot, dict[int, Command]] = field(default_factory=lambda: {robot: {} for robot in ROBOTS})
    views: dict[Robot, dict[int, StateImage]] = field(default_factory=lambda: {robot: {} for robot in ROBOTS})
    plans: dict[int, Plan] = field(default_factory=dict)
    ticks: list[Tick] = field(default_factory=list)
    late: dict[int, tuple[Robot, ...]] = field(default_factory=dict)
    lost: int = 0
    malformed: int = 0
    discarded: bool = False

    @property
    def number(self) -> int:
        """The episode's number."""
        return self.episode.episode

    @property
    def steps(self) -> int:
        """Steps played: the last step that has both poses."""
        return max(self.poses["hider"].keys() & self.poses["seeker"].keys(), default=0)

    @property
    def complete(self) -> bool:
        """Whether the game is data: whole, and not discarded."""
        return self.whole and not self.discarded

    @property
    def whole(self) -> bool:
        """Whether the game ended by the rules and nothing of layout, poses, depth and colour pictures is missing."""
        if self.episode.phase != "ended" or self.layout is None or self.lost or self.malformed:
            return False
        expected = range(self.steps + 1)
        return all(
            step in held[robot] for held in (self.poses, self.depths, self.colors) for robot in ROBOTS for step in expected
        )

    def add(self, key: str, message: Message) -> None:
        """Take a message of this game, other than the referee's words; a layout only until the game is over.

        Of a step that is there twice, the first counts (what comes later may be of a game of the same number whose set-up is
        still to come), but of plans the newest."""
        robot: Robot = "seeker" if key.startswith("seeker/") else "hider"
        match message:
            case Layout():
                if self.layout is None or self.episode.phase in ("setup", "running"):
                    self.layout = message
            case Pose():
                self.poses[robot].setdefault(message.step, message)
            case DepthImage():
                self.depths[robot].setdefault(message.step, message)
            case ColorImage():
                self.colors[robot].setdefault(message.step, message)
            case Command():
                self.commands[robot].setdefault(message.step, message)
            case StateImage():
                self.views[robot].setdefault(message.step, message)
            case Plan():
                self.plans[message.step] = message
            case Tick():
                self.ticks.append(message)
                if message.late:
                    self.late[message.step] = message.late


def episodes(records: Iterable[Record]) -> Iterator[EpisodeLog]:
    """Group the messages of a log into games, in the order in which they were set up; see `vantage.log.games` for the rules.

    A game is handed out when the next but one is set up: if it is discarded later than that, see `games_of`.

    Args:
        records: of one log, in order: `read(path, topics=EPISODE_TOPICS)`.
    """
    held: dict[int, EpisodeLog] = {}  # by place: the two games set up last
    early: dict[int, list[tuple[str, Message]]] = {}
    for record, message, game in messages_of(records, EPISODE_TOPICS, Games()):
        if game is None:
            assert message is not None
            early.setdefault(message.episode, []).append((record.key, message))
            while len(early) > 2:
                early.pop(next(iter(early)))
        elif message is None:
            held[game.place].malformed += 1
        elif isinstance(message, Gap):
            held[game.place].lost += message.missed
        elif isinstance(message, Control):
            if game.place in held:
                held[game.place].discarded = True
        elif isinstance(message, Episode):
            if game.place in held:
                held[game.place].episode = game.episode
                continue
            while len(held) > 1:
                yield held.pop(next(iter(held)))
            held[game.place] = EpisodeLog(message, game.place)
            for key, waiting in early.pop(message.episode, ()):
                held[game.place].add(key, waiting)
        else:
            held[game.place].add(record.key, message)
    yield from held.values()


def games_of(log: Log, topics: Collection[str] = EPISODE_TOPICS) -> Iterator[EpisodeLog]:
    """Group the messages of a log into games, as `episodes`, and know of each whether it was discarded, however much later."""
    controlled = any(channel.topic == "control" for file in log.files for channel in file.channels.values())
    words = heard(log.records(WORD_TOPICS)) if controlled else []
    for game in episodes(log.records(topics)):
        game.discarded |= game.place < len(words) and words[game.place].discarded
        yield game
