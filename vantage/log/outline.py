"""The games of a log without their pictures, and their steps one after the other: for logs larger than memory.

`episodes` holds whole games; here a first pass over the log notes which steps of each game it has, so that a second pass can
hand out each step as soon as its messages are together, whatever order the publishers came in.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field

from schemas import ROBOTS, Control, Episode, Gap, Layout, MalformedMessage, Message, Plan, Robot, Tick
from vantage.log.episodes import EPISODE_TOPICS
from vantage.log.games import AboutGame, Game, Games, messages_of
from vantage.log.reader import Log
from vantage.log.target import Progress, in_silence

_PARTS = ("pose", "depth", "color")


@dataclass
class GameOutline(AboutGame):
    """What a log has of one game.

    Attributes:
        game: what the referee said of it, and when.
        first_time, last_time: log times of its first and last message, ns.
        since: log time after which messages of this number belong to it, ns.
        held: key -> bit mask of the steps that the log has.
        late: step -> robots that stayed because their command did not come in time.
        layout: the arena, None when the log lacks it.
        lost, malformed: messages of the game that are missing, or did not decode.
    """

    first_time: int
    last_time: int
    since: int = -1
    held: dict[str, int] = field(default_factory=dict)
    late: dict[int, tuple[Robot, ...]] = field(default_factory=dict)
    layout: Layout | None = None
    lost: int = 0
    malformed: int = 0

    @property
    def steps(self) -> int:
        """Steps played: the last step that has both poses."""
        return max((self.held.get("hider/pose", 0) & self.held.get("seeker/pose", 0)).bit_length() - 1, 0)

    @property
    def complete(self) -> bool:
        """Whether the game is data: whole, and not discarded."""
        return self.whole and not self.discarded

    @property
    def whole(self) -> bool:
        """Whether the game ended by the rules and nothing of layout, poses, depth and colour pictures is missing."""
        if self.episode.phase != "ended" or self.layout is None or self.lost or self.malformed:
            return False
        return all(self.has(f"{robot}/{part}", self.steps + 1) for robot in ROBOTS for part in _PARTS)

    def has(self, key: str, count: int) -> bool:
        """Return whether the log has steps 0 .. `count` - 1 of a key."""
        expected = (1 << count) - 1
        return self.held.get(key, 0) & expected == expected

    def has_step(self, key: str, step: int) -> bool:
        """Return whether the log has this step of a key."""
        return bool(self.held.get(key, 0) >> step & 1)

    def stayed(self, robot: Robot, step: int) -> bool:
        """Return whether the robot stayed at a step because its command did not come in time."""
        return robot in self.late.get(step, ())


def called(game: GameOutline) -> str:
    """Return what a game is called for people: its number, and that it was discarded."""
    return f"game {game.number}{', discarded' if game.discarded else ''}"


def outline(log: Log, progress: Progress = in_silence) -> list[GameOutline]:
    """Go through a log once and return its games, in the order in which they were set up; see `vantage.log.games`."""
    outlines: list[GameOutline] = []
    early: dict[int, GameOutline] = {}  # what came before the first word
    first, last = time_span(log)
    for count, (record, message, game) in enumerate(messages_of(log.records(EPISODE_TOPICS), EPISODE_TOPICS, Games())):
        if count % 256 == 0:
            progress("reading", (record.log_time - first) / max(last - first, 1))
        if game is None:
            assert message is not None
            waiting = early.setdefault(message.episode, GameOutline(Game(-1), record.log_time, record.log_time))
            _note(waiting, record.key, message)
            while len(early) > 2:
                early.pop(next(iter(early)))
        elif message is None:
            outlines[game.place].malformed += 1
        elif isinstance(message, Gap):
            outlines[game.place].lost += message.missed
        elif isinstance(message, Episode):
            if game.place == len(outlines):
                outlined = GameOutline(game, record.log_time, record.log_time, game.since)
                outlines.append(outlined)
                before = early.pop(message.episode, None)
                if before is not None:
                    outlined.first_time = before.first_time
                    outlined.since = min(outlined.since, before.first_time - 1)
                    outlined.held, outlined.late, outlined.layout = before.held, before.late, before.layout
            outlines[game.place].last_time = record.log_time
        elif not isinstance(message, Control):  # a game knows by itself that it was discarded
            outlined = outlines[game.place]
            _note(outlined, record.key, message)
            outlined.last_time = record.log_time
    progress("reading", 1.0)
    return outlines


def steps_of(
    log: Log, games: Sequence[GameOutline], keys: Collection[str], progress: Progress = in_silence
) -> Iterator[tuple[GameOutline, int, dict[str, Message]]]:
    """Yield every step of the games, game after game and in order: (game, step, key -> message).

    A step comes when everything is there that the log has of it; only what publishers run ahead of each other is held in memory.
    Of a message that is there twice, the first counts, but of plans the newest that came before the step was together.

    Args:
        log: where `games` come from.
        games: outlines of some of its games, in its order.
        keys: what is wanted of a step.
    """
    first, last = time_span(log)
    waiting: list[dict[int, dict[str, Message]]] = [{} for _ in games]
    places: dict[int, list[int]] = {}
    for place, game in enumerate(games):
        places.setdefault(game.number, []).append(place)
    wanted = [_wanted(game, keys) for game in games]
    place = step = 0

    def ready() -> Iterator[tuple[GameOutline, int, dict[str, Message]]]:
        nonlocal place, step
        while place < len(games):
            game = games[place]
            count = max((mask.bit_length() for mask in wanted[place].values()), default=0)
            while step < count:
                expected = {key for key, mask in wanted[place].items() if mask >> step & 1}
                held = waiting[place].get(step, {})
                if not expected <= held.keys():
                    return
                waiting[place].pop(step, None)
                if expected:
                    yield game, step, held
                step += 1
            waiting[place].clear()
            place, step = place + 1, 0

    yield from ready()
    if place == len(games):
        return
    begin = min(game.first_time for game in games) - 1
    for number, record in enumerate(log.records(keys, after=begin)):
        if number % 64 == 0:
            progress("writing", (record.log_time - first) / max(last - first, 1))
        try:
            message = record.decode()
        except MalformedMessage:
            continue
        candidates = places.get(message.episode)
        if not candidates:
            continue
        # Of several games with one number, the last that had begun.
        owner = max((c for c in candidates if games[c].since < record.log_time), default=-1)
        if owner < place or (owner == place and message.step < step):
            continue
        if not wanted[owner].get(record.key, 0) >> message.step & 1:
            continue  # it came so late that the game is not given it
        held = waiting[owner].setdefault(message.step, {})
        if record.key not in held or isinstance(message, Plan):
            held[record.key] = message
        if owner == place:
            yield from ready()
            if place == len(games):
                break
    progress("writing", 1.0)


def time_span(log: Log) -> tuple[int, int]:
    """Return the log times of the first and the last message, ns, as the chunks' heads tell them; 0 and 0 for an empty log."""
    chunks = [chunk for file in log.files for chunk in file.chunks if chunk.end]
    return (min(chunk.start for chunk in chunks), max(chunk.end for chunk in chunks)) if chunks else (0, 0)


def _wanted(game: GameOutline, keys: Collection[str]) -> dict[str, int]:
    return {key: game.held[key] for key in keys if key in game.held}


def _note(game: GameOutline, key: str, message: Message) -> None:
    match message:
        case Layout():
            # Not that of the next game of this number, whose set-up may be still to come.
            if game.layout is None or not game.game.words or game.episode.phase in ("setup", "running"):
                game.layout = message
        case Tick():
            if message.late:
                game.late[message.step] = message.late
        case _:
            game.held[key] = game.held.get(key, 0) | 1 << message.step
