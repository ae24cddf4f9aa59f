"""A lossless stream: the messages of one publisher on one key, put back in order and without gaps.

The publisher keeps its last messages and answers questions for them. This is the reader's side, as a pure state machine: what
arrives goes in, what is to be delivered comes out, and `question` says what to ask the publisher for. One mechanism serves the
late joiner, what was published before the two had met, what the network dropped, and what a stopped reader did not take.

What is published reaches a reader that has subscribed, so whatever arrives live is new. Only what comes out of a publisher's
cache may be older than the subscription; the caller judges that, by a clock that both share (`vantage.bus.clock`). Where they
share none, the reader takes for old what it finds in the cache before it has joined, up to the first message that arrived live.

Zenoh's own `AdvancedSubscriber` is not used: when it meets a publisher again after a lost connection it asks for its history
first, and then reports everything between as missed instead of fetching it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

AnyItem = TypeVar("AnyItem")

CATCH_UP = 16
"""How many past messages a reader asks for when it meets a publisher, to find those published while the two were connecting."""


WINDOW = 16
"""How many missing messages a reader asks for at once: more, and their sheer number would be dropped on the way."""

DOUBT = 3
"""How often a publisher must answer with later messages only, before those asked for count as gone: answers get lost, too."""


@dataclass(frozen=True, slots=True)
class Missing:
    """So many messages can no longer be had."""

    count: int


class Stream(Generic[AnyItem]):
    """The reader's side of one stream.

    Args:
        history: how many messages published before the reader subscribed it wants.
        limit: how many messages may wait for missing ones; beyond that the missing are given up.
    """

    def __init__(self, history: int, limit: int) -> None:
        self.next: int | None = None  # sequence to deliver next; None until the reader has joined
        self.held: dict[int, tuple[bool, AnyItem]] = {}  # sequence -> (is it history, message)
        self._history = history
        self._limit = limit
        self._last = -1  # highest sequence the publisher is known to have published
        self._live_from: int | None = None  # lowest sequence that arrived live
        self._owes_all = False  # the publisher is known to have started after the reader subscribed
        self._asking = False
        self._worth_asking = False
        self._lowest_answer: int | None = None
        self._ask_all = False
        self._asked_for = -1  # the `next` of the last question
        self._in_vain = 0  # questions since that did not bring it
        self._doubt = 0  # of these, those that brought later ones
        self._kept_from = 0  # the publisher keeps nothing below
        self._gone = False

    def follows(self, sequence: int) -> bool:
        """Return whether a message that arrived is the next and nothing is held up: deliver it. The short way of `arrived`."""
        if sequence == self.next and not self.held:
            self.next += 1
            return True
        return False

    def arrived(self, sequence: int, item: AnyItem, *, owes_all: bool = False) -> list[AnyItem | Missing]:
        """Take a message as it was published. Returns what to deliver.

        Args:
            owes_all: its publisher is known to have started after the reader subscribed.
        """
        self._worth_asking = True
        self._owes_all = self._owes_all or owes_all
        self._live_from = sequence if self._live_from is None else min(self._live_from, sequence)
        if self.next is None and sequence == 0:
            self.next = 0
        if self.next is not None and sequence < self.next:
            return []
        self.held[sequence] = (False, item)
        if len(self.held) > self._limit:
            return self._give_up()
        return self._drain() if self.next is not None else []

    def announced(self, last: int) -> None:
        """Take note of a publisher that is (again) there, and of the sequence of its last message (-1: unknown)."""
        self._worth_asking = True
        self._gone = False
        self._last = max(self._last, last)

    def left(self) -> bool:
        """Take note that the publisher is not to be seen any more: dead, or only out of reach.

        Returns whether something is missing, so that `abandon` should be called after a while.
        """
        self._gone = True
        return self._incomplete()

    def abandon(self) -> list[AnyItem | Missing]:
        """Wait no longer for what is missing, unless the publisher is back."""
        return self._give_up() if self._gone and self._incomplete() else []

    def _incomplete(self) -> bool:
        return bool(self.held) or (self.next is not None and self._last >= self.next)

    def question(self) -> str | None:
        """Return what to ask the publisher's cache for now, as its parameters; None for nothing. `ended` must follow."""
        if self._asking or not self._worth_asking:
            return None
        if self.next is not None and not self._incomplete():
            return None
        self._asking, self._worth_asking, self._lowest_answer = True, False, None
        if self.next is None:
            return "_sn=0.." if self._ask_all else f"_max={max(self._history, CATCH_UP)}"
        if self.next != self._asked_for:
            self._asked_for, self._in_vain, self._doubt = self.next, 0, 0
        return f"_sn={self.next}.." if self._in_vain else f"_sn={self.next}..{self.next + WINDOW - 1}"

    def answered(self, sequence: int, item: AnyItem, *, old: bool | None, owes_all: bool = False) -> list[AnyItem | Missing]:
        """Take a message out of the publisher's cache, which answers in order; some answers may get lost.

        Args:
            old: it was published before the reader subscribed; None: no common clock tells.
            owes_all: as in `arrived`.
        """
        self._owes_all = self._owes_all or owes_all
        if self._lowest_answer is None:
            self._lowest_answer = sequence
        if old is None:
            old = self.next is None and (self._live_from is None or sequence < self._live_from)
        if self.next is None or sequence >= self.next:
            self.held.setdefault(sequence, (old, item))
        return self._drain() if self.next is not None else []

    def ended(self) -> list[AnyItem | Missing]:
        """Take note that no more answers come to the last question."""
        self._asking = False
        if self._lowest_answer is not None:
            self._worth_asking = True
        if self.next is None:
            delivered = self._join(for_good=self._ask_all and self._lowest_answer is not None)
            self._ask_all = bool(self.held) and self._lowest_answer is not None
            return delivered
        if self.next == self._asked_for:
            self._in_vain += 1
            if self._lowest_answer is not None:
                self._doubt += 1
                if self._doubt >= DOUBT:
                    self._kept_from = self._lowest_answer
        return self._drain()

    def _join(self, for_good: bool) -> list[AnyItem | Missing]:
        """Start delivering, the wanted history and everything since, if it is sure (or for good) where that begins."""
        if not self.held:
            return []
        history = sorted(sequence for sequence, (old, _) in self.held.items() if old)
        if not (history or 0 in self.held or for_good):
            return []
        for sequence in history[: max(0, len(history) - self._history)]:
            del self.held[sequence]
        if self._owes_all:
            self.next = 0
        elif history:
            self.next = history[-1] + 1 - min(self._history, len(history))
        else:
            self.next = min(self.held)
        return self._drain()

    def _drain(self) -> list[AnyItem | Missing]:
        """Deliver what is next, over the gaps that nobody can fill."""
        delivered: list[AnyItem | Missing] = []
        assert self.next is not None
        while self.held:
            found = self.held.pop(self.next, None)
            if found is not None:
                # Where answers got lost, the reader may have joined too early; who wants no history must not get any.
                if self._history or not found[0]:
                    delivered.append(found[1])
                self.next += 1
            elif self.next < self._kept_from:
                resumed = min(min(self.held), self._kept_from)
                delivered.append(Missing(resumed - self.next))
                self.next = resumed
            else:
                break
        return delivered

    def _give_up(self) -> list[AnyItem | Missing]:
        """Deliver all there is; what is not, is missing."""
        delivered = self._join(for_good=True) if self.next is None else []
        if self.next is None:
            return delivered
        self._kept_from = max((*self.held, self._last)) + 1
        delivered += self._drain()
        if self.next <= self._last:
            delivered.append(Missing(self._last + 1 - self.next))
            self.next = self._last + 1
        return delivered
