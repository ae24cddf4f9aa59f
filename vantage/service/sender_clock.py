"""The clock of another process, which may run on another machine: its stamps are translated into this process's own time.

Two clocks are never compared as such. A stamp and the time of publication are of the sender's clock, and so is their difference;
how far that clock is from the own one follows from the messages that travelled fastest.
"""

from __future__ import annotations

SECOND = 1_000_000_000
JUMP = SECOND // 2
"""ns by which a sender's clock may seem to jump before its distance is estimated anew."""
SILENCE = SECOND
"""ns of silence after which the sender may have been restarted, with another clock."""
SET_BACK = 3
"""Messages in a row, advancing among themselves, that show a clock set back; fewer are late or repeated ones."""
DRIFT = 1e-3
"""How much slower than the own clock a sender's may run, relatively: twice the rate at which NTP slews."""
OLDEST_PUBLISHED = SECOND
"""ns from a stamp to its publication at most; beyond, the two are not of one clock and the difference means nothing."""


class SenderClock:
    """Translates the stamps of one sender's messages on one topic. See module."""

    def __init__(self) -> None:
        self._offset: int | None = None  # own clock minus the sender's, less the fastest way here
        self._stamp = 0  # newest taken, sender's clock
        self._heard = 0
        self._taken = 0  # newest, own clock
        self._doubtful = (0, 0)  # newest stamp that lay before `_stamp`, and how many of them came in a row

    def take(self, stamp: int, published: int, now: int) -> int | None:
        """Return the own time (ns) of a stamp; None where the message proves nothing about now.

        That is one that is not newer than the last (repeated, or overtaken), and the first of a sender that was silent: it may
        have been kept for those who come late, and is of any age.

        Args:
            stamp: of the message, the sender's clock.
            published: when it was published, the sender's clock; 0: unknown, it counts as published at once.
            now: own clock, at its arrival.
        """
        departed = published if 0 <= published - stamp <= OLDEST_PUBLISHED else stamp
        offset = now - departed
        silent, self._heard = now - self._heard, now
        if self._offset is None or (offset > self._offset + JUMP and silent > SILENCE and stamp > self._stamp):
            self._offset, self._stamp = offset, stamp
            return None
        if stamp <= self._stamp:
            before, count = self._doubtful
            self._doubtful = (stamp, count + 1 if count and stamp > before else 1)
            if self._doubtful[1] < SET_BACK:
                return None
            self._offset = offset
        elif offset > self._offset + JUMP:
            pass  # a message that is late, or many: they are as old as they are
        elif offset < self._offset - JUMP:
            self._offset = offset
        else:
            self._offset = min(self._offset + int(DRIFT * silent), offset)
        self._doubtful = (0, 0)
        self._stamp = stamp
        # A better estimate must not make time run backwards.
        self._taken = max(min(stamp + self._offset, now), self._taken + 1)
        return self._taken
