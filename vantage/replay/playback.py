"""The replay of a log as a pure core: which messages are due, what is to be said after a jump, and how it stands.

No clock, no bus, no files: real time `now` (ns) is an argument, the log comes from a `Source`. Whatever was recorded at the
position or before has been said, nothing after it has. After a jump the present state of things is said, so that everybody
joins there: the referee's words on the game (its set-up first), and the latest message of every topic that belongs to it.

A replay that stands within a running game lets the referee say that the game is paused, as a live one would: nobody then takes
the missing poses for a fault.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from msgspec.structs import replace

from schemas import FASTEST, SLOWEST, TOPICS, Episode, Layout, MalformedMessage, Message, Tick
from schemas import Playback as PlaybackMessage
from vantage.log.games import Game, Word
from vantage.log.reader import Record
from vantage.replay.log_clock import LogClock

SECOND = 1_000_000_000
BATCH = 64
"""Messages that are said at once; in between, wishes are heard."""
LAG = SECOND // 4
"""ns that messages may be late; beyond, the log's clock waits for them: who was held up does not shout afterwards."""
SETTLE = SECOND * 3 // 20
"""ns of silence between a jump and the state: publishers are not ordered among each other, so what was said before dies down,
and that there was a jump is known."""
SILENCE = 5 * SECOND // 2
"""ns of the log after which a service that says each second how it does was silent when it was recorded."""
NOT_STATE = frozenset({"episode", "gap", "control"})
"""Topics whose latest message is not said after a jump: the episode is said by itself, the others are events."""

State = Literal["playing", "paused", "ended"]


class Source(Protocol):
    """A log: `vantage.replay.recording.Recording`."""

    @property
    def name(self) -> str: ...
    @property
    def start(self) -> int: ...
    @property
    def end(self) -> int: ...
    @property
    def games(self) -> Sequence[Game]: ...
    def records(self, after: int) -> Iterator[Record]: ...
    def latest(self, position: int) -> Mapping[str, Record]: ...


@dataclass(frozen=True, slots=True)
class Said:
    """A message to publish, who published it when it was recorded, and when that was (log time, ns)."""

    key: str
    publisher: str
    message: Message
    log_time: int


class Playback:
    """See the module.

    Args:
        source: the log.
        is_played: whether a publisher's messages of a key are to be said.
        now: real time at which it begins, ns.
        speed: log seconds a real second.
        paused: wait for `resume`.
        loop: at the end, begin again.
        position: log time to begin at, ns; None = before the first message.

    Attributes:
        jumps: how often it went to another place.
        skipped: why -> messages that were not said.
    """

    def __init__(
        self,
        source: Source,
        is_played: Callable[[str, str], bool],
        now: int,
        *,
        speed: float = 1.0,
        paused: bool = False,
        loop: bool = False,
        position: int | None = None,
    ) -> None:
        self._source = source
        self._is_played = is_played
        self._loop = loop
        self._paused = paused
        self._ended = False
        self._clock = LogClock(source.start - 1, speed)
        self._records: Iterator[Record] = iter(())
        self._next: Record | None = None
        self._starts = [game.start for game in source.games]
        self._word: Word | None = None
        self._step = 0
        self._state_due: int | None = None
        self.jumps = 0
        self.skipped: Counter[str] = Counter()
        self._go_to(source.start - 1 if position is None else position, now, SETTLE if position is not None else 0)

    @property
    def state(self) -> State:
        return "ended" if self._ended else "paused" if self._paused else "playing"

    @property
    def speed(self) -> float:
        return self._clock.speed

    def position(self, now: int) -> int:
        """Return the log time up to which everything has been said, ns."""
        reached = min(self._clock.time(now), self._source.end)
        return reached if self._next is None else min(reached, self._next.log_time - 1)

    def game(self, now: int) -> int | None:
        """Return the index of the game reached; None before the first."""
        index = bisect_right(self._starts, self.position(now)) - 1
        return index if index >= 0 else None

    def report(self, now: int) -> PlaybackMessage:
        """Return how it stands."""
        index, position = self.game(now), self.position(now)
        return PlaybackMessage(
            stamp=max(position, 0),
            episode=0 if index is None else self._source.games[index].number,
            step=self._step,
            log=self._source.name[:200],
            position=max(0, position - self._source.start) / SECOND,
            duration=(self._source.end - self._source.start) / SECOND,
            speed=self.speed,
            state=self.state,
            jumps=self.jumps,
        )

    def wake_at(self, now: int) -> int | None:
        """Return the real time at which `turn` has something to do; None while there is nothing."""
        if self._state_due is not None:
            return self._state_due
        if not self._clock.running:
            return None
        return now if self._next is None else self._clock.reached_at(self._next.log_time)

    def turn(self, now: int) -> list[Said]:
        """Return what is to be said now, in order; at most `BATCH` messages of the log at once."""
        if self._state_due is not None:
            if now < self._state_due:
                return []
            return self._say_state(now)
        if not self._clock.running:
            return []
        due: list[Said] = []
        reached = self._clock.time(now)
        for _ in range(BATCH):
            if self._next is None or self._next.log_time > reached:
                break
            self._say(self._next, due)
            self._next = next(self._records, None)
        if self._next is None:
            due += self._end(now)
        elif reached - self._next.log_time > LAG * self._clock.speed:
            self._clock.set(self._next.log_time, now)
        return due

    def pause(self, now: int) -> list[Said]:
        """Stand still."""
        if self._paused:
            return []
        self._paused = True
        return self._stand(self.position(now), now)

    def resume(self, now: int, speed: float | None = None) -> list[Said]:
        """Go on, perhaps at another speed; at the end of the log, from its beginning."""
        if speed is not None:
            self.set_speed(speed, now)
        if self._ended:
            self._paused = False
            self.seek(0.0, now)
            return []
        if not self._paused:
            return []
        self._paused = False
        if self._state_due is None:
            self._clock.run(now)
        return self._game_stands(False)

    def set_speed(self, speed: float, now: int) -> None:
        """Change the speed, within what there is."""
        self._clock.set(self.position(now), now)
        self._clock.speed = min(max(speed, SLOWEST), FASTEST)

    def seek(self, position: float, now: int) -> None:
        """Go to `position` s after the log's first message, or as near as the log allows; it goes on there as it stood."""
        self.jumps += 1
        whole = self._source.end - self._source.start
        self._go_to(self._source.start + round(min(max(position, 0.0) * SECOND, whole)), now, SETTLE)

    def seek_by(self, seconds: float, now: int) -> None:
        """Go forward, or back."""
        self.seek((self.position(now) - self._source.start) / SECOND + seconds, now)

    def seek_game(self, index: int, now: int) -> None:
        """Go to the set-up of a game; before the first, to the beginning; after the last, nowhere."""
        if index < len(self._starts):
            self.seek((self._starts[index] - self._source.start) / SECOND if index >= 0 else 0.0, now)

    def _go_to(self, position: int, now: int, settle: int) -> None:
        self._ended = False
        self._clock.stop(now)
        self._clock.set(position, now)
        self._next, self._word = None, None
        self._state_due = now + settle

    def _say_state(self, now: int) -> list[Said]:
        self._state_due = None
        position = self._clock.time(now)
        self._records = self._source.records(position)
        self._next = next(self._records, None)
        self._step = 0
        said: list[Said] = []
        index = bisect_right(self._starts, position) - 1
        game = self._source.games[index] if index >= 0 else None
        if game is not None:
            self._say_words(game, position, said)
        state: list[Said] = []
        for record in sorted(self._source.latest(position).values(), key=lambda record: record.log_time):
            # Who had fallen silent does not seem alive because somebody came here.
            fresh = not record.key.startswith("health/") or position - record.log_time < SILENCE
            if fresh and record.key not in NOT_STATE:
                self._say(record, state, game)
        # The layout before all else: who plans at the first complete step may want it.
        said += sorted(state, key=lambda each: not isinstance(each.message, Layout))
        if self._word is not None and self._word.said.phase != "running":
            self._step = self._word.said.step
        if self._paused:
            return said + self._game_stands(True)
        self._clock.run(now)
        return said

    def _say_words(self, game: Game, position: int, said: list[Said]) -> None:
        """Say the set-up of a game, that it runs, and how it ended, as far as that had come at `position`."""
        words = [word for word in game.words if word.time <= position]
        first = words[0]
        setup = replace(first.said, phase="setup", step=0, paused=False)  # a log may begin within a game
        last = {word.said.phase: word for word in words}
        chosen = [Word(first.time, first.publisher, setup)]
        if "running" in last:
            chosen.append(last["running"])
        if words[-1].said.phase in ("ended", "aborted"):
            chosen.append(words[-1])
        for word in chosen:
            if self._is_played("episode", word.publisher):
                said.append(Said("episode", word.publisher, word.said, word.time))
                self._word = word

    def _say(self, record: Record, said: list[Said], game: Game | None = None) -> None:
        """Add a message of the log if it can be said; with `game`, only if it belongs to that game or to none."""
        if record.key not in TOPICS:
            self.skipped["on a key that is not in the topic table"] += 1
            return
        if not self._is_played(record.key, record.publisher):
            return
        try:
            message = record.decode()
        except MalformedMessage:
            self.skipped["malformed"] += 1
            return
        if game is not None and message.episode and (message.episode != game.number or record.log_time <= game.since):
            return
        if isinstance(message, Episode):
            self._word = Word(record.log_time, record.publisher, message)
            self._step = message.step
        elif isinstance(message, Tick):
            self._step = message.step
        said.append(Said(record.key, record.publisher, message, record.log_time))

    def _end(self, now: int) -> list[Said]:
        if self._loop and self._source.end > self._source.start:
            self.seek(0.0, now)
            return []
        self._ended = True
        return self._stand(self._source.end, now)

    def _stand(self, position: int, now: int) -> list[Said]:
        self._clock.stop(now)
        self._clock.set(position, now)
        return self._game_stands(True) if self._state_due is None else []

    def _game_stands(self, paused: bool) -> list[Said]:
        """Let the referee say that the running game is paused, or what it said before."""
        word = self._word
        if word is None or word.said.phase != "running" or word.said.paused:
            return []
        return [Said("episode", word.publisher, replace(word.said, step=self._step, paused=paused), word.time)]
