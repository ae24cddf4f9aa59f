"""Watching the cameras: who gives no frames, and what is not seen in them."""

from __future__ import annotations

from collections.abc import Iterable

from vantage.service import SECOND

PATIENCE_AT_REST = 3.0
"""Seconds without a frame that are no trouble while no game runs."""


class CameraWatch:
    """Knows when each thing (a camera's frame, a robot's tag) was last there, and puts what is missing into words.

    Args:
        names: of the things, as people know them; each is given until `patience` after the first check to appear.
        missing: how to say that it is not there, between its name and its age.
    """

    def __init__(self, names: Iterable[str], missing: str) -> None:
        self._last: dict[str, int | None] = dict.fromkeys(names)
        self._errors: dict[str, str] = {}
        self._missing = missing
        self._since: int | None = None

    def there(self, name: str, now: int) -> None:
        """It is there now."""
        self._last[name] = now
        self._errors.pop(name, None)

    def lost(self, name: str, error: str) -> None:
        """It is known to be gone, and why."""
        self._errors[name] = error

    def held_up(self, lag: int) -> None:
        """Do not count `lag` ns in which nobody looked."""
        self._last = {name: None if last is None else last + lag for name, last in self._last.items()}
        if self._since is not None:
            self._since += lag

    def is_fresh(self, name: str, now: int, patience: float) -> bool:
        """Whether it was there within the last `patience` seconds."""
        last = self._last[name]
        return name not in self._errors and last is not None and now - last <= patience * SECOND

    def troubles(self, now: int, patience: float) -> list[str]:
        """Return what is missing for longer than `patience` seconds, each as a text for people."""
        if self._since is None:
            self._since = now
        texts = []
        for name, last in self._last.items():
            if error := self._errors.get(name):
                texts.append(error if error.startswith(name) else f"{name}: {error}")
            elif last is None:
                if now - self._since > patience * SECOND:
                    texts.append(f"{name}: {self._missing} yet")
            elif now - last > patience * SECOND:
                texts.append(f"{name}: {self._missing} for {(now - last) / SECOND:.1f} s")
        return texts
