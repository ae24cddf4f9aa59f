"""How often something may happen, in all and for each page."""

from __future__ import annotations


class Rate:
    """A bucket of `burst` pieces that fills with `per_second`; each event takes one."""

    def __init__(self, per_second: float, burst: float) -> None:
        self._per_second, self._burst = per_second, burst
        self._level = burst
        self._at: float | None = None

    def take(self, now: float) -> bool:
        """Return whether an event may happen at `now`, s."""
        if self._at is not None:
            self._level = min(self._burst, self._level + max(0.0, now - self._at) * self._per_second)
        self._at = now
        if self._level < 1.0:
            return False
        self._level -= 1.0
        return True


class Shares:
    """A bucket for each page, and one that bounds them all: no page can use up what another one needs.

    Args:
        own: events a second and at once, of one page.
        total: of all pages together.
    """

    def __init__(self, own: tuple[float, float], total: tuple[float, float]) -> None:
        self._own = own
        self._total = Rate(*total)
        self._pages: dict[int, Rate] = {}

    def take(self, client: int, now: float, urgent: bool) -> bool:
        """Return whether a page's event may happen at `now`, s; one that is urgent is bounded by the page's own bucket only."""
        own = self._pages.setdefault(client, Rate(*self._own))
        return own.take(now) and (urgent or self._total.take(now))

    def forget(self, client: int) -> None:
        """The page is gone."""
        self._pages.pop(client, None)
