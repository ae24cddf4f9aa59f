"""What a check came to: one line each, and what to do where something is wrong."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rich.markup import escape


@dataclass(frozen=True, slots=True)
class Verdict:
    """One check.

    Attributes:
        what: was looked at.
        found: what it came to, with figures.
        remedy: what to do; empty: all is well.
    """

    what: str
    found: str
    remedy: str = ""

    @property
    def ok(self) -> bool:
        return not self.remedy

    def line(self, width: int) -> str:
        """Return it as one line of rich's markup, its name padded to a width."""
        mark = "[green]ok     [/]" if self.ok else "[red]trouble[/]"
        remedy = "" if self.ok else f" → {escape(self.remedy)}"
        return f"{mark}  {escape(self.what):<{width}}  {escape(self.found)}{remedy}"


def lines(verdicts: Iterable[Verdict]) -> list[str]:
    """Return verdicts as lines of equal indent."""
    listed = list(verdicts)
    width = max((len(verdict.what) for verdict in listed), default=0)
    return [verdict.line(width) for verdict in listed]
