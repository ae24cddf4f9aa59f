"""What waits to be sent to one page: of each key only the newest frame, in the order in which the keys came first."""

from __future__ import annotations

OF_NO_GAME = frozenset({"welcome", "notice"})
"""Keys of what is not forgotten with the games: without its welcome a page shows nothing."""

FORGET = "forget"
"""Place of a frame with which a page forgets: a newer one of its key, which forgets nothing, is not to take it."""


class Outbox:
    """Never more than one frame a key, so that a slow browser costs a bounded amount of memory and sees the present."""

    KEYS = 512
    """Keys that wait at most; the oldest goes."""

    def __init__(self) -> None:
        self._frames: dict[str, bytes] = {}

    def __len__(self) -> int:
        return len(self._frames)

    def put(self, key: str, frame: bytes, forget: bool = False) -> None:
        """Add a frame, in place of an unsent one of its key; `forget`: what else waits of games is of the past."""
        if forget:
            self._frames = {other: waiting for other, waiting in self._frames.items() if other in OF_NO_GAME}
            key = FORGET
        elif key not in self._frames and len(self._frames) >= self.KEYS:
            del self._frames[next(iter(self._frames))]
        self._frames[key] = frame

    def take(self) -> bytes | None:
        """Return the frame that is to be sent next, or None."""
        if not self._frames:
            return None
        return self._frames.pop(next(iter(self._frames)))
