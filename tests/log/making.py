"""Logs to test with."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

from schemas import (
    PRIMITIVES,
    ROBOTS,
    ColorImage,
    Command,
    DepthImage,
    Episode,
    Intrinsics,
    Layout,
    Message,
    Plan,
    Pose,
    Tick,
    encode,
)
from vantage.log import LogWriter, Record, RunMetadata

START = 1_800_000_000_000_000_000
STEP = 250_000_000
LENS = Intrinsics(fx=4.0, fy=4.0, cx=3.5, cy=0.0)


def game(number: int, steps: int, seed: int = 1, phase: str = "ended") -> Iterable[tuple[str, Message]]:
    """The messages of a made-up game, as a table in simulation would say them."""

    def common(step: int) -> dict[str, int]:
        return {"stamp": START + number * 1000 * STEP + step * STEP, "episode": number, "step": step}

    yield "episode", Episode(**common(0), seed=seed, phase="setup")
    yield "layout", Layout(**common(0))
    for step in range(steps + 1):
        for robot in ROBOTS:
            angle = 0.1 * step + (robot == "seeker")
            x, y = 0.6 + 0.3 * math.cos(angle), 0.6 + 0.3 * math.sin(angle)
            yield f"{robot}/pose", Pose(**common(step), x=x, y=y, heading=0.0)
            yield f"{robot}/depth", DepthImage(**common(step), width=8, height=1, intrinsics=LENS, data=bytes([step % 256]) * 16)
            yield f"{robot}/color", ColorImage(**common(step), width=8, height=1, intrinsics=LENS, data=bytes([step % 256]) * 24)
        if step == 0:
            yield "episode", Episode(**common(0), seed=seed, phase="running")
            yield "hider/plan", Plan(**common(0), horizon=steps)
        if step < steps:
            yield "tick", Tick(**common(step))
            for robot in ROBOTS:
                yield f"{robot}/command", Command(**common(step), primitive=PRIMITIVES[step % 5])
    if phase != "setup":
        yield "episode", Episode(**common(steps), seed=seed, phase=phase, outcome="survived", reason="over")


def records_of(messages: Iterable[tuple[str, Message]], start: int = START, period: int = 1_000_000) -> list[Record]:
    """Messages as records, a millisecond apart, numbered by topic."""
    counts: dict[str, int] = {}
    records = []
    for place, (key, message) in enumerate(messages):
        sequence = counts.get(key, 0)
        counts[key] = sequence + 1
        time = start + place * period
        records.append(Record(key, "simulator", sequence, time, time - 1000, encode(message)))
    return records


def write_record(log: LogWriter, record: Record) -> None:
    log.write(
        record.key,
        record.payload,
        log_time=record.log_time,
        publish_time=record.publish_time,
        sequence=record.sequence,
        publisher=record.publisher,
        well_formed=record.well_formed,
    )


def write_log(path: Path, records: Iterable[Record], **options: object) -> None:
    with LogWriter(path, RunMetadata(commit="test", started=START), **{"sync": False, **options}) as log:  # type: ignore[arg-type]
        for record in records:
            write_record(log, record)
