"""How often the web server cut somebody off lately, for health."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping

from vantage.service import SECOND

LATELY = 10 * SECOND
"""ns that a refusal is told of."""

HARMLESS = frozenset({"no such file", "malformed request", "gone silent", "no token", "wrong token"})
"""Reasons that are only counted: browsers ask for files that no page names, a laptop goes to sleep, and a page that was left open
comes back with the token of an earlier deployment, every three seconds."""


class RefusedLately:
    """Turns the server's running counts into what happened within the last ten seconds."""

    def __init__(self) -> None:
        self._before: Counter[str] = Counter()
        self._recent: deque[tuple[int, Counter[str]]] = deque()
        self.trouble = ""

    def add(self, counts: Mapping[str, int], now: int) -> None:
        """Take in the counts since the server started."""
        total = Counter({reason: count for reason, count in counts.items() if reason not in HARMLESS})
        self._recent.append((now, total - self._before))
        self._before = total
        self.forget_old(now)

    def forget_old(self, now: int) -> None:
        while self._recent and now - self._recent[0][0] > LATELY:
            self._recent.popleft()
        lately: Counter[str] = Counter()
        for _, counts in self._recent:
            lately += counts
        kinds = ", ".join(f"{kind} {count}" for kind, count in lately.most_common())
        refused = sum(lately.values())
        self.trouble = f"{refused} requests refused in the last {LATELY // SECOND} s ({kinds})" if refused else ""
