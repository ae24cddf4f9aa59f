"""Joining the messages of one step."""

from __future__ import annotations

from collections import OrderedDict

from schemas import Message
from vantage.service.core import Unexpected


class StepJoin:
    """Collects the messages of one step until all of `keys` are there, whatever order they come in.

    Different publishers are not ordered among each other: a pose of the next episode may come before the episode itself,
    so a few early messages are kept. A replay may go back to an earlier episode or step: what seems late since the last `begin`
    is kept, too, for the next one. A step that lost a message is forgotten with the next one that is complete.
    """

    EARLY = 32
    """Unfinished steps that are kept at most."""

    def __init__(self, keys: tuple[str, ...]) -> None:
        self._keys = keys
        self._episode = 0
        self._next_step = 0
        self._waiting: OrderedDict[tuple[int, int], dict[str, Message]] = OrderedDict()
        self._late: OrderedDict[tuple[int, int], dict[str, Message]] = OrderedDict()

    @property
    def episode(self) -> int:
        """Number of the episode being joined, 0 before the first."""
        return self._episode

    def begin(self, episode: int) -> tuple[Message, ...] | None:
        """Turn to an episode. Returns its latest step that is already complete: who joins a game late joins it there."""
        self._episode = episode
        self._next_step = 0
        self._forget_before(episode, 0)
        late, self._late = self._late, OrderedDict()
        for place, joined in late.items():
            if place[0] == episode:
                self._waiting[place] = joined | self._waiting.get(place, {})
        for place in sorted((place for place in self._waiting if place[0] == episode), reverse=True):
            complete = self._take(place)
            if complete is not None:
                return complete
        return None

    def add(self, key: str, message: Message) -> tuple[Message, ...] | None:
        """Add a message; return the step's messages in the order of `keys` once all are there, else None.

        Raises:
            Unexpected: the message belongs to an earlier episode or step, or came twice.
        """
        place = (message.episode, message.step)
        if message.episode < self._episode or (message.episode == self._episode and message.step < self._next_step):
            self.keep(key, message)
            raise Unexpected(f"{key} of episode {message.episode} step {message.step} came late")
        joined = self._waiting.setdefault(place, {})
        if key in joined:
            raise Unexpected(f"{key} of episode {message.episode} step {message.step} came twice")
        joined[key] = message
        if len(self._waiting) > self.EARLY:
            # Not the step that is being played, whatever else comes in.
            present = (self._episode, self._next_step)
            del self._waiting[next(other for other in self._waiting if other != present)]
        if message.episode != self._episode or self._episode == 0:
            return None
        return self._take(place)

    def keep(self, key: str, message: Message) -> None:
        """Keep a message of a game that is over, or of an earlier step, in case a replay is about to begin there."""
        self._late.setdefault((message.episode, message.step), {})[key] = message
        if len(self._late) > self.EARLY:
            self._late.popitem(last=False)

    def _take(self, place: tuple[int, int]) -> tuple[Message, ...] | None:
        joined = self._waiting.get(place, {})
        if len(joined) < len(self._keys):
            return None
        self._next_step = place[1] + 1
        self._forget_before(self._episode, self._next_step)
        return tuple(joined[key] for key in self._keys)

    def _forget_before(self, episode: int, step: int) -> None:
        for place in [place for place in self._waiting if place < (episode, step)]:
            del self._waiting[place]
