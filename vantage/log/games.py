"""Which games a log holds: the one reading of what the referee, and those who discard games, say.

Whatever groups messages into games (`episodes`, `outline`, a report, a replay) does it by `Games`; `messages_of` is how a log
is gone through for it:

* A set-up begins a game, unless it is the newest of its number said again (same stamp, same seed). So does a word on a number
  that was never set up: the log begins within that game. A game is told by its place in the log, because numbers and seeds come
  again.
* A message belongs to the newest game of its number, as long as that is one of the two games set up last: publishers are not
  ordered among each other, but not that far apart.
* A game that ended stays so: a restarted referee declares the last game it hears of aborted. Seed, rules and players are those
  of the first word, because that referee does not know them.
* A discard means the newest game of its number, however long ago that was.
* A loss, or a message that does not decode, may concern the games of those two that have not ended; where both have, the last.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Protocol, TypeVar

from msgspec import structs

from schemas import Control, Episode, Gap, MalformedMessage, Message
from vantage.errors import UserError
from vantage.log.reader import MOST_LISTED, Record

WORD_TOPICS = ("episode", "control")
"""What has to be read to know the games."""


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
        place: among the games of the log, from 0.
        words: of the referee, as far as they are believed, in order; the first is the set-up, unless the log begins within the
            game.
        since: log time after which messages of this number belong to this game and not to an earlier one, ns; -1: all before.
        discarded_at: log time at which somebody said (`control`) that the game is not to be used as data, ns; None: nobody did.
    """

    place: int
    words: list[Word] = field(default_factory=list)
    since: int = -1
    discarded_at: int | None = None

    @property
    def discarded(self) -> bool:
        """Whether it is not to be used as data."""
        return self.discarded_at is not None

    @property
    def number(self) -> int:
        return self.words[0].said.episode

    @property
    def start(self) -> int:
        """Log time of the first word, ns."""
        return self.words[0].time

    @property
    def episode(self) -> Episode:
        """How it stands: the last word, with seed, rules and players of the first."""
        first, last = self.words[0].said, self.words[-1].said
        return structs.replace(last, seed=first.seed, rules=first.rules, players=first.players)


@dataclass
class AboutGame:
    """What is known of one game, with the referee's words on it."""

    game: Game

    @property
    def number(self) -> int:
        """The episode's number."""
        return self.game.number

    @property
    def start(self) -> int:
        """Log time of the referee's first word, ns."""
        return self.game.start

    @property
    def episode(self) -> Episode:
        """The last word of the referee."""
        return self.game.episode

    @property
    def discarded(self) -> bool:
        """Whether somebody said later (`control`) that the game is not to be used as data."""
        return self.game.discarded


class Games:
    """Hears the words of a log one after the other.

    Attributes:
        all: the games so far, in order.
    """

    def __init__(self) -> None:
        self.all: list[Game] = []
        self._newest: dict[int, Game] = {}

    def owner(self, number: int) -> Game | None:
        """Return the game that a message of this number belongs to now."""
        game = self._newest.get(number)
        return game if game is not None and game.place >= len(self.all) - 2 else None

    def under_way(self) -> Sequence[Game]:
        """Return the games that a loss may concern now."""
        newest = self.all[-2:]
        return [game for game in newest if game.words[-1].said.phase in ("setup", "running")] or newest[-1:]

    def hear(self, word: Word) -> Game | None:
        """Take a word; return the game that it belongs to (a new one has no other word), None when it is not believed."""
        said = word.said
        if said.episode == 0:
            return None
        known = self._newest.get(said.episode)
        if known is None or (said.phase == "setup" and _begins_anew(known, said)):
            # Of a number that was there before, what came earlier belongs to the earlier game.
            game = Game(len(self.all), [word], -1 if known is None else word.time - 1)
            self.all.append(game)
            self._newest[said.episode] = game
            return game
        if said.phase == "setup" or self.owner(said.episode) is not known:
            return None
        if known.words[-1].said.phase == "ended" and said.phase != "ended":
            return None
        known.words.append(word)
        return known

    def heed(self, time: int, control: Control) -> Game | None:
        """Take a wish, recorded at a log time (ns); return the game that it discards."""
        game = self._newest.get(control.episode) if control.action == "discard" else None
        if game is not None:
            game.discarded_at = time
        return game


def _begins_anew(known: Game, said: Episode) -> bool:
    first = known.words[0].said
    return (first.phase, first.stamp, first.seed) != ("setup", said.stamp, said.seed)


def messages_of(
    records: Iterable[Record], topics: Collection[str], games: Games
) -> Iterator[tuple[Record, Message | None, Game | None]]:
    """Go through a log and yield each record of some topics with its message and the game that it concerns.

    The message is None where it does not decode; that, and a `Gap` on these topics, comes once for each game under way. A wish
    (`control`) concerns the game that it discards. The game is None while nothing was said of it yet. Left out is what concerns
    no game, and words that are not believed.

    Args:
        records: of one log, in order.
        topics: others are passed over.
        games: is told what the log says of games.
    """
    for record in records:
        if record.key not in topics:
            continue
        try:
            message = record.decode()
        except MalformedMessage:
            for game in games.under_way():
                yield record, None, game
            continue
        if isinstance(message, Gap):
            if message.key in topics:
                for game in games.under_way():
                    yield record, message, game
        elif isinstance(message, Control):
            if (discarded := games.heed(record.log_time, message)) is not None:
                yield record, message, discarded
        elif isinstance(message, Episode):
            if (spoken_of := games.hear(Word(record.log_time, record.publisher, message))) is not None:
                yield record, message, spoken_of
        elif message.episode:
            yield record, message, games.owner(message.episode)


def games_of(records: Iterable[Record]) -> list[Game]:
    """Return the games of a log.

    Args:
        records: at least those of `WORD_TOPICS`, in order.
    """
    games = Games()
    for _ in messages_of(records, WORD_TOPICS, games):
        pass
    return games.all


class Said(Protocol):
    """A game as far as it is told by what was said of it."""

    @property
    def discarded(self) -> bool: ...
    @property
    def episode(self) -> Episode: ...


class Judged(Said, Protocol):
    """A game of which is known whether anything is missing."""

    @property
    def whole(self) -> bool: ...


def unfinished(game: Said) -> str:
    """Return why a game does not count, to be said of it ("left out: 3 games ..."); empty when it does."""
    if game.discarded:
        return "discarded by the player"
    if game.episode.phase == "aborted":
        return "aborted"
    return "" if game.episode.phase == "ended" else "not finished in this log"


def unusable(game: Judged) -> str:
    """Return why a game is no data: it does not count, or messages are missing; empty when it is."""
    return unfinished(game) or ("" if game.whole else "with messages missing")


class NoSuchGame(UserError):
    """A number does not name one game of a log; the text says which there are, for people."""


class Findable(Protocol):
    """What a game is found by."""

    @property
    def number(self) -> int: ...
    @property
    def start(self) -> int: ...
    @property
    def episode(self) -> Episode: ...


AnyGame = TypeVar("AnyGame", bound=Findable)


def find_game(games: Sequence[AnyGame], number: int) -> AnyGame:
    """Return the game of this number.

    Raises:
        NoSuchGame: there is none, or several.
    """
    found = [game for game in games if game.number == number]
    if not found:
        numbers = [str(game.number) for game in games]
        more = f" and {len(numbers) - MOST_LISTED} more" if len(numbers) > MOST_LISTED else ""
        raise NoSuchGame(f"there is no game {number} in this log; there is: {', '.join(numbers[:MOST_LISTED]) or 'none'}{more}")
    if len(found) > 1:
        first = games[0].start
        lines = [
            f"  at {_clock(game.start)}, {(game.start - first) / 1e9:.1f} s after the first game, seed {game.episode.seed}"
            for game in found[:MOST_LISTED]
        ]
        raise NoSuchGame("\n".join([f"{len(found)} games of this log have the number {number}:", *lines]))
    return found[0]


def _clock(time: int) -> str:
    return datetime.fromtimestamp(time / 1e9).astimezone().isoformat(sep=" ", timespec="seconds")
