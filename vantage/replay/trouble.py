"""What can be wrong with a replay, for people."""

from __future__ import annotations


class ReplayError(Exception):
    """What went wrong and what to do."""

    for_people = True
