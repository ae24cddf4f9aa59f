"""Where to look for tags: the whole picture now and then, a tile at a time, so that no frame costs much."""

from __future__ import annotations

from vantage.tracking.tags import Window

TILE = 256
"""px, side of a tile without its overlap"""


def tiles_of(width: int, height: int, overlap: int) -> tuple[Window, ...]:
    """Cut a picture into tiles that overlap so far (px) that a tag not wider than that is whole in one of them."""
    return tuple(
        (left, top, min(left + TILE + overlap, width), min(top + TILE + overlap, height))
        for top in range(0, height, TILE)
        for left in range(0, width, TILE)
        if left + overlap < width and top + overlap < height
    )


def clipped(column: float, row: float, half: float, width: int, height: int) -> Window:
    """Return the square window of half a side (px) around a place, cut at the picture's edges."""
    return (
        *(max(int(column - half), 0), max(int(row - half), 0)),
        *(max(min(int(column + half) + 1, width), 0), max(min(int(row + half) + 1, height), 0)),
    )


class SearchPlan:
    """When to search beyond the windows.

    Args:
        tiles: of the picture.
        period: s between two searches of all tiles.
        urgent_period: s between two searches of the whole picture while something is missing.
    """

    def __init__(self, tiles: tuple[Window, ...], period: float, urgent_period: float) -> None:
        self._tiles, self._period, self._urgent_period = tiles, round(period * 1e9), round(urgent_period * 1e9)
        self._whole: int | None = None
        self._begun: int | None = None
        self._next = len(tiles)

    def whole_due(self, stamp: int, urgent: bool) -> bool:
        """Whether the whole picture is to be searched in this frame; if so, it counts as searched."""
        if self._whole is not None and stamp < self._whole:
            self._whole = self._begun = None
        if self._whole is not None and not (urgent and stamp - self._whole >= self._urgent_period):
            return False
        self._whole = self._begun = stamp
        self._next = len(self._tiles)
        return True

    def tile_due(self, stamp: int) -> tuple[Window | None, bool]:
        """Return the tile to search in this frame if there is one, and whether that completes the picture."""
        if self._next >= len(self._tiles):
            if self._begun is not None and 0 <= stamp - self._begun < self._period:
                return None, False
            self._begun, self._next = stamp, 0
        tile = self._tiles[self._next]
        self._next += 1
        return tile, self._next == len(self._tiles)
