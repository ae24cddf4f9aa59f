"""What the page's device captures: pages that come, ask and go, and how often somebody was refused."""

from __future__ import annotations

from dataclasses import dataclass, field

from services.console.requests import AnyRequest

PAGE = "page"
"""Name of the device."""


@dataclass(frozen=True, slots=True)
class PageEvent:
    """A page came, asked for something, or went.

    Attributes:
        client: the page's number; none is used twice.
        request: None where it came or went.
        here: whether the page is (still) there.
    """

    client: int
    request: AnyRequest | None = None
    here: bool = True


@dataclass(frozen=True, slots=True)
class Refusals:
    """What the web server has refused since it started: reason -> how often."""

    counts: dict[str, int] = field(default_factory=dict)
