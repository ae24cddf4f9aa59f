"""What the seeker saw at each step of the present game."""

from __future__ import annotations

from schemas import StateImage
from services.console.frames import frame
from services.console.requests import Views


class PastViews:
    """The seeker's state images of one episode; the oldest go beyond `LIMIT`."""

    LIMIT = 400

    def __init__(self) -> None:
        self._episode = 0
        self._views: dict[int, bytes] = {}

    def add(self, image: StateImage) -> None:
        """Keep a view; the first of another episode puts those of the last one away."""
        if image.episode != self._episode:
            self.forget()
            self._episode = image.episode
        self._views.pop(image.step, None)
        self._views[image.step] = image.data
        if len(self._views) > self.LIMIT:
            del self._views[next(iter(self._views))]

    def forget(self) -> None:
        """Put everything away."""
        self._episode = 0
        self._views.clear()

    def frames(self, asked: Views) -> list[bytes]:
        """Return a frame for each step asked for that has been seen; a step to come is asked for again."""
        if asked.episode != self._episode:
            return []
        found = [(step, self._views[step]) for step in asked.steps if step in self._views]
        return [frame(f"past/{step}", {"episode": asked.episode, "step": step}, data) for step, data in found]
