"""Words for people: what messages say in the log panels of viewers."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from schemas import Control, Episode, Gap, Health, Message, Motion, Playback
from vantage.printable import counted

Level = Literal["debug", "info", "warning", "error"]


class Words(NamedTuple):
    """A line of text: how important, who says it, what. Never the name of a person."""

    level: Level
    name: str
    text: str


def words_of(key: str, message: Message) -> Words | None:
    """Return what a message says, None when it says nothing in words."""
    match message:
        case Episode():
            phase = "paused" if message.paused else message.phase
            ending = f": {message.outcome} {message.reason}".rstrip() if message.phase in ("ended", "aborted") else ""
            level: Level = "warning" if message.phase == "aborted" else "info"
            return Words(level, "referee", f"episode {message.episode} (seed {message.seed}) {phase}{ending}")
        case Health():
            level = "warning" if message.state == "degraded" else "debug"
            return Words(level, message.service, f"{message.state} {message.reason}".rstrip())
        case Gap():
            return Words(
                "error", "recorder", f"{counted(message.missed, 'message')} of {message.key} from {message.publisher} lost"
            )
        case Control():
            return Words("info", "control", message.action + _wish(message))
        case Motion():
            off = f"{1000 * message.distance_error:.1f} mm and {math.degrees(message.heading_error):.1f} degrees off"
            battery = "" if message.battery is None else f", {message.battery:.1f} V"
            text = f"{message.primitive}, now step {message.step}: {message.result}, {off}, {message.elapsed:.2f} s{battery}"
            level = "debug" if message.result == "completed" else "warning"
            return Words(level, key, f"{text} {message.reason}".rstrip())
        case Playback():
            place = f"{message.position:.1f} of {message.duration:.1f} s"
            return Words("info", "replay", f"{message.log}: {message.state} at {place}, {message.speed:g} times as fast")
    return None


def _wish(control: Control) -> str:
    match control.action:
        case "start":
            return f": {control.games or 'endless'} games from seed {control.seed}"
        case "discard":
            return f" episode {control.episode}"
        case "seek":
            return f" to {control.position:.1f} s"
        case "resume" if control.speed is not None:
            return f" at {control.speed:g} times the speed"
    return ""
