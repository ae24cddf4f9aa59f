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
    MalformedMessage,
    Message,
    Plan,
    Pose,
    Robot,
    StateImage,
    Tick,
)
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
        """Take a message of this game; the newest of a step counts."""
        robot: Robot = "seeker" if key.startswith("seeker/") else "hider"
        match message:
            case Episode():
                # A restarted referee declares the last game it hears of aborted, also one that had ended.
                if (self.episode.phase, message.phase) != ("ended", "aborted"):
                    self.episode = message
            case Layout():
                self.layout = message
            case Pose():
                self.poses[robot][message.step] = message
            case DepthImage():
                self.depths[robot][message.step] = message
            case ColorImage():
                self.colors[robot][message.step] = message
            case Command():
                self.commands[robot][message.step] = message
            case StateImage():
                self.views[robot][message.step] = message
            case Plan():
                self.plans[message.step] = message
            case Tick():
                self.ticks.append(message)
                if message.late:
                    self.late[message.step] = message.late


def episodes(records: Iterable[Record]) -> Iterator[EpisodeLog]:
    """Group the messages of a log into games, in the order in which they were set up.

    A message belongs to the game whose number it carries, wherever it stands in the log (publishers are not ordered among each
    other), as long as it comes before the set-up of the next game but one. A number that is set up again with another seed is a
    new game.

    A game that is discarded while a later one but one is played has been handed out by then: see `games_of`.

    Args:
        records: of one log, in order: `read(path, topics=EPISODE_TOPICS)`.
    """
    games: dict[int, EpisodeLog] = {}
    early: dict[int, list[tuple[str, Message]]] = {}
    for record in records:
        if record.key not in EPISODE_TOPICS:
            continue
        try:
            message = record.decode()
        except MalformedMessage:
            for game in _under_way(games):
                game.malformed += 1
            continue
        if isinstance(message, Gap):
            if message.key in EPISODE_TOPICS:
                for game in _under_way(games):
                    game.lost += message.missed
            continue
        number = message.episode
        if number == 0:
            continue
        if isinstance(message, Control):
            if message.action == "discard" and number in games:
                games[number].discarded = True
            continue
        if isinstance(message, Episode) and message.phase == "setup":
            known = games.get(number)
            if known is not None and known.episode.seed != message.seed:
                yield games.pop(number)
                known = None
            if known is None:
                while len(games) > 1:
                    yield games.pop(next(iter(games)))
                games[number] = EpisodeLog(message)
                for key, waiting in early.pop(number, ()):
                    games[number].add(key, waiting)
                continue
        if number in games:
            games[number].add(record.key, message)
        elif isinstance(message, Episode):
            # The log begins within a game.
            games[number] = EpisodeLog(message)
            for key, waiting in early.pop(number, ()):
                games[number].add(key, waiting)
        else:
            early.setdefault(number, []).append((record.key, message))
            while len(early) > 2:
                early.pop(next(iter(early)))
    yield from games.values()


def games_of(log: Log, topics: Collection[str] = EPISODE_TOPICS) -> Iterator[EpisodeLog]:
    """Group the messages of a log into games, as `episodes`, and know of each whether it was discarded, however much later."""
    controlled = any(channel.topic == "control" for file in log.files for channel in file.channels.values())
    discarded = _discarded(log.records(("episode", "control"))) if controlled else frozenset()
    for game in episodes(log.records(topics)):
        game.discarded |= (game.number, game.episode.seed) in discarded
        yield game


def _discarded(records: Iterable[Record]) -> frozenset[tuple[int, int]]:
    """Return the games that were discarded as (number, seed): a wish means the newest game of its number."""
    seeds: dict[int, int] = {}
    found = set()
    for record in records:
        try:
            message = record.decode()
        except MalformedMessage:
            continue
        if isinstance(message, Episode):
            seeds[message.episode] = message.seed
        elif isinstance(message, Control) and message.action == "discard" and message.episode in seeds:
            found.add((message.episode, seeds[message.episode]))
    return frozenset(found)


def _under_way(games: dict[int, EpisodeLog]) -> list[EpisodeLog]:
    """The games that a loss may concern: those not ended; else the last."""
    playing = [game for game in games.values() if game.episode.phase in ("setup", "running")]
    return playing or list(games.values())[-1:]
