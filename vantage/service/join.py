"""Joining the messages of one step."""

from __future__ import annotations

from collections import OrderedDict

from schemas import Message
from vantage.service.core import Unexpected


class StepJoin:
    """Collects the messages of one step until all of `keys` are there, whatever order they come in.

    Different publishers are not ordered among each other: a pose of the next episode may come before the episode itself,
    so a few early messages are kept.
    """

    EARLY = 32

    def __init__(self, keys: tuple[str, ...]) -> None:
        self._keys = keys
        self._episode = 0
        self._next_step = 0
        self._waiting: OrderedDict[tuple[int, int], dict[str, Message]] = OrderedDict()

    @property
    def episode(self) -> int:
        """Number of the episode being joined, 0 before the first."""
        return self._episode

    def begin(self, episode: int) -> tuple[Message, ...] | None:
        """Turn to an episode. Returns its first step if that is already complete."""
        self._episode = episode
        self._next_step = 0
        for key in [key for key in self._waiting if key[0] < episode]:
            del self._waiting[key]
        for key in sorted(key for key in self._waiting if key[0] == episode):
            complete = self._take(key)
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
            raise Unexpected(f"{key} of episode {message.episode} step {message.step} came late")
        joined = self._waiting.setdefault(place, {})
        if key in joined:
            raise Unexpected(f"{key} of episode {message.episode} step {message.step} came twice")
        joined[key] = message
        if message.episode != self._episode or self._episode == 0:
            if len(self._waiting) > self.EARLY:
                self._waiting.popitem(last=False)
            return None
        return self._take(place)

    def _take(self, place: tuple[int, int]) -> tuple[Message, ...] | None:
        joined = self._waiting[place]
        if len(joined) < len(self._keys):
            return None
        del self._waiting[place]
        self._next_step = place[1] + 1
        return tuple(joined[key] for key in self._keys)
