"""The account of messages that a log lacks: nothing leaves it before a note of it is in the file."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from pathlib import Path

from vantage.log.metadata import VIEWER_PREFIX

MOST_NAMES = 4096
"""(topic, publisher) pairs that are counted apart; further ones are counted together, as `**`."""

Name = tuple[str, str]
"""Topic and publisher."""
NOTES: Name = ("gap", "recorder")
"""What the notes of losses are published as."""


def add_to(counts: dict[Name, int], name: Name, missed: int) -> None:
    """Add to a count; strangers may name any number of topics and publishers."""
    if name not in counts and len(counts) >= MOST_NAMES:
        name = ("**", "")
    counts[name] = counts.get(name, 0) + missed


class Losses:
    """See module. A loss is owed, then noted in an open chunk, then (when that chunk is in the file) delivered.

    Attributes:
        all: every loss, by topic and publisher.
        dropped: those of them that came here and could not be written.
        owed: without a note yet.
        delivered: with a note in the present part.
    """

    def __init__(self) -> None:
        self.all: dict[Name, int] = {}
        self.dropped: dict[Name, int] = {}
        self.owed: dict[Name, int] = {}
        self.delivered: dict[Name, int] = {}
        self._noted: dict[Name, int] = {}

    def drop(self, counts: dict[Name, int]) -> int:
        """Count messages that could not be written, and owe a note of them: not of notes, nor of what viewers are shown.

        Returns:
            How many they are.
        """
        lost = {name: n for name, n in counts.items() if name != NOTES and not name[0].startswith(VIEWER_PREFIX)}
        for name, missed in lost.items():
            for account in (self.all, self.dropped, self.owed):
                add_to(account, name, missed)
        return sum(lost.values())

    def note(self, name: Name, missed: int) -> None:
        """Count messages that were lost before they came here, and of which a note is in the open chunk."""
        add_to(self.all, name, missed)
        add_to(self._noted, name, missed)

    def notes_due(self) -> Iterator[tuple[Name, int]]:
        """Yield the losses without a note; the caller must write one for each."""
        owed, self.owed = self.owed, {}
        for name, missed in owed.items():
            add_to(self._noted, name, missed)
            yield name, missed

    def chunk_written(self) -> None:
        """Deliver the notes: their chunk is in the file."""
        noted, self._noted = self._noted, {}
        for name, missed in noted.items():
            add_to(self.delivered, name, missed)

    def chunk_lost(self) -> None:
        """Owe the notes again: their chunk could not be written."""
        noted, self._noted = self._noted, {}
        for name, missed in noted.items():
            add_to(self.owed, name, missed)

    def part_lost(self) -> None:
        """Owe again what was delivered in a part that is gone."""
        for name, missed in self.take_delivered().items():
            add_to(self.owed, name, missed)

    def take_delivered(self) -> dict[Name, int]:
        """Return what was delivered in the part that ends, and begin the account of the next."""
        taken, self.delivered = self.delivered, {}
        return taken

    def reason(self, path: Path, is_open: bool, error: OSError) -> str:
        """Return why messages are being dropped, in one line.

        Args:
            path: the file.
            is_open: whether it could be created.
            error: of the disk.
        """
        is_full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        if is_full and not is_open:
            why = f"the disk is full: no room in {path.parent}"
        else:
            why = f"{path if is_open else path.parent}: {'the disk is full' if is_full else error.strerror or error}"
        return f"{why}; messages dropped so far: {sum(self.dropped.values())}"


def has_room(folder: Path, size: int) -> bool:
    """Return whether `size` bytes fit on the disk of a folder: on a full one a few messages may fit now and then."""
    try:
        disk = os.statvfs(folder)
    except OSError:
        return False
    return disk.f_bavail * disk.f_frsize >= size
