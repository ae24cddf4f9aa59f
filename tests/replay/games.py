"""Small logs made for tests: games of a few steps, with what surrounds them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from schemas import Command, Control, Episode, Health, Layout, Message, Pose, Tick, encode
from vantage.log.reader import Record
from vantage.replay.recording import Game, games_of

MILLISECOND = 1_000_000
PUBLISHERS = {
    "episode": "referee",
    "tick": "referee",
    "layout": "simulator",
    "hider/pose": "simulator",
    "seeker/pose": "simulator",
    "hider/command": "planner",
    "health/planner": "planner",
    "control": "command-line",
}


def game(number: int, seed: int, steps: int, ending: str) -> list[tuple[str, Message]]:
    """The messages of one game in order; `ending` is a phase, or empty for a game that nobody ended."""
    place = {"stamp": 1, "episode": number}
    said: list[tuple[str, Message]] = [
        ("episode", Episode(**place, seed=seed, phase="setup")),
        ("layout", Layout(**place)),
        ("hider/pose", Pose(**place, x=0.1, y=0.1, heading=0.0)),
        ("episode", Episode(**place, seed=seed, phase="running")),
    ]
    for step in range(steps):
        place = {"stamp": 2 + step, "episode": number, "step": step}
        said += [
            ("tick", Tick(**place)),
            ("health/planner", Health(stamp=2 + step, service="planner", state="ok", process=7, uptime=1.0)),
            ("hider/command", Command(**place, primitive="forward")),
            ("hider/pose", Pose(stamp=3 + step, episode=number, step=step + 1, x=0.1 + 0.01 * step, y=0.1, heading=0.0)),
        ]
    if ending:
        said.append(("episode", Episode(stamp=9, episode=number, step=steps, seed=seed, phase=ending)))  # type: ignore[arg-type]
    return said


def recorded(said: Sequence[tuple[str, Message | bytes]], gaps: Sequence[int], start: int = 1_000 * MILLISECOND) -> list[Record]:
    """Records of messages in this order, each `gaps` ns (in turn, at least 1) after the one before; bytes are malformed ones."""
    records = []
    time = start
    for number, (key, message) in enumerate(said):
        time += max(1, gaps[number % len(gaps)])
        payload = message if isinstance(message, bytes) else encode(message)
        records.append(Record(key, PUBLISHERS.get(key, "nobody"), number, time, time, payload, (key, message) != MALFORMED))
    return records


WISH = ("control", Control(stamp=1, action="start"))
MALFORMED: tuple[str, bytes] = ("tick", b"\xc1")
UNKNOWN: tuple[str, bytes] = ("nobody/declared/this", b"\x80")


class ListedSource:
    """A log in memory: what `Recording` gives, found by looking at every record."""

    name = "listed"

    def __init__(self, records: Sequence[Record]) -> None:
        self.all = list(records)
        self.start, self.end = self.all[0].log_time, self.all[-1].log_time
        self.games: Sequence[Game] = games_of(record for record in self.all if record.key == "episode")

    def records(self, after: int) -> Iterator[Record]:
        return iter([record for record in self.all if record.log_time > after])

    def latest(self, position: int) -> Mapping[str, Record]:
        return {record.key: record for record in self.all if record.log_time <= position and record.well_formed}
