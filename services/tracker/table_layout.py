"""The layout: not said before all boxes are known, word for word the same while they stand, and kept for the whole of a game."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from schemas import Box, Layout
from vantage.tracking.overhead import Observation
from vantage.tracking.table import Table

MOVED = 0.010
TURNED = math.radians(4.0)
"""A box is news when it is seen this far from where it was published, m and rad; less is the camera's noise."""


class TableLayout:
    """What is published of the boxes.

    Args:
        table: its size.

    Attributes:
        trouble: a box that stands elsewhere than in the layout of the game, for people.
    """

    def __init__(self, table: Table) -> None:
        self.trouble = ""
        self._table = table
        self._seen: dict[int, Box] | None = None  # by tag, last seen; None until all are known
        self._published: dict[int, Box] | None = None
        self._episode = 0

    def see(self, observation: Observation, episode: int) -> bool:
        """Take in a picture, seen while this episode is played (0: none). Returns whether there is a layout to be said."""
        if self._seen is None and not observation.boxes_known:
            return False
        self._seen = dict(zip(observation.box_tags, observation.boxes, strict=True))
        self.trouble = "; ".join(self._changes()) if self._kept_for(episode) else ""
        if self._kept_for(episode):
            return False
        return episode != 0 or self._has_changed()

    def message(self, stamp: int, episode: int) -> Layout | None:
        """Return the layout of an episode (0: none is played), None while the boxes are not known yet."""
        if self._seen is None:
            return None
        if self._has_changed() and not self._kept_for(episode):
            self._published = self._seen
        assert self._published is not None
        self._episode = episode
        obstacles = tuple(self._published.values())
        return Layout(stamp=stamp, episode=episode, width=self._table.width, depth=self._table.depth, obstacles=obstacles)

    def _kept_for(self, episode: int) -> bool:
        """Whether this episode has its layout: starts were drawn and ways are planned by it."""
        return episode != 0 and self._published is not None and self._episode == episode

    def _has_changed(self) -> bool:
        before, after = self._published, self._seen
        if before is None or after is None or before.keys() != after.keys():
            return True
        return have_moved(before.values(), after.values())

    def _changes(self) -> list[str]:
        """Say which boxes truly stand elsewhere; that one is not seen, the camera's own troubles say."""
        seen: Mapping[int, Box] = self._seen or {}
        published: Mapping[int, Box] = self._published or {}
        moved = [tag for tag in seen if tag in published and have_moved((published[tag],), (seen[tag],))]
        new = [tag for tag in seen if tag not in published]
        return [
            *(f"box {tag} was moved during the game" for tag in moved),
            *(f"box {tag} was put on the table during the game" for tag in new),
        ]


def have_moved(before: Collection[Box], after: Collection[Box]) -> bool:
    """Whether boxes came, went, or stand noticeably elsewhere: each is compared with the nearest one of before."""
    if len(before) != len(after):
        return True
    for box in after:
        nearest = min(before, key=lambda other: math.hypot(other.x - box.x, other.y - box.y))
        turned = math.remainder(box.heading - nearest.heading, math.tau)
        if math.hypot(nearest.x - box.x, nearest.y - box.y) > MOVED or abs(turned) > TURNED:
            return True
    return False
