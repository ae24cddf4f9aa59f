"""Who says what in a replay: each recorded publisher by a session of its own name, unless somebody of that name is alive."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

from schemas import TOPICS

REPLAY = "replay"
"""The session that tells how the replay stands."""
SCRIPTED = "hider"
"""Who drives the hider where neither planner nor console do: what a human drove is said under this name beside a live console."""
NOT_PLAYED = frozenset({"control", "playback"})
"""Wishes of the recorded day would start games, or move the replay about."""


@dataclass
class Cast:
    """See the module.

    Attributes:
        voices: (key, publisher of the log) -> name of the session that says it.
        replaced: publishers whose place a live service takes, or that are left out by wish -> how to say so.
        unplayable: (key, publisher) that nobody may say -> why.
    """

    voices: dict[tuple[str, str], str] = field(default_factory=dict)
    replaced: dict[str, str] = field(default_factory=dict)
    unplayable: dict[tuple[str, str], str] = field(default_factory=dict)

    def sessions(self) -> list[str]:
        """Return the names of the sessions needed."""
        return sorted({*self.voices.values(), REPLAY})


def cast(publishers: Collection[tuple[str, str]], alive: Collection[str], without: Collection[str]) -> Cast:
    """Return who says what.

    Two kinds of messages are said by others than their recorded publishers, so that they are not missing: what the recorded
    predictor answered beside a live one (by `replay`), and what a human drove beside a live console (by `hider`).

    Args:
        publishers: (key, publisher) pairs of the log.
        alive: services on the bus.
        without: names to leave out, for services that are still to come.
    """
    result = Cast()
    away = {*alive, *without}
    for key, publisher in sorted(publishers):
        topic = TOPICS.get(key)
        if topic is None:
            result.unplayable[key, publisher] = "is not in the topic table"
        elif key in NOT_PLAYED:
            continue
        elif publisher not in topic.publishers:
            result.unplayable[key, publisher] = f"may not be published by {publisher or 'a stranger'}"
        elif publisher not in away:
            result.voices[key, publisher] = publisher
        else:
            live = publisher in alive
            result.replaced[publisher] = f"played by the live {publisher} instead" if live else "left out, as you wish"
            if publisher == "predictor" and REPLAY in topic.publishers and live and "planner" not in away:
                result.voices[key, publisher] = REPLAY  # a live planner asks for itself
            elif publisher == "console" and SCRIPTED in topic.publishers and live and SCRIPTED not in away:
                result.voices[key, publisher] = SCRIPTED
    return result
