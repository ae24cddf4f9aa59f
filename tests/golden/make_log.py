"""Writes the golden log of the present schema version: `python -m tests.golden.make_log`.

A committed golden log is never written again: it must read for ever. A new schema version gets one of its own, and its
description with `python -m schemas.evolution > tests/golden/schemas_vN.json`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from schemas import (
    GOAL_COUNT,
    TOPICS,
    Box,
    ColorImage,
    Command,
    Control,
    DepthImage,
    Episode,
    Gap,
    Health,
    InputHealth,
    Intrinsics,
    Layout,
    Message,
    Motion,
    Plan,
    Playback,
    Players,
    Pose,
    PredictReply,
    PredictRequest,
    Rules,
    StateImage,
    Tick,
    Track,
    encode,
)
from schemas.evolution import SCHEMA_VERSION
from vantage.log import LogWriter, RunMetadata

GOLDEN = Path(__file__).resolve().parent
START = 1_800_000_000_000_000_000


def example(key: str, step: int) -> Message:
    """Return a plausible message of a topic, the same each time."""
    kind = TOPICS[key].type
    common = {"stamp": START + 250_000_000 * step, "episode": 3, "step": step}
    lens = Intrinsics(fx=4.25, fy=4.25, cx=3.5, cy=0.0)
    image = (np.arange(128 * 128) // 4096).astype(np.uint8).tobytes()
    path = np.stack([np.linspace(0.3, 0.9, 7), np.full(7, 0.6), np.zeros(7)], axis=1).astype("<f4")
    players = Players(hider="human", seeker="expert", person="Ada")
    fields: dict[type[Message], dict[str, object]] = {
        Episode: {
            "seed": 42,
            "phase": "ended" if step else "setup",
            "outcome": "caught" if step else "undecided",
            "caught_step": 1 if step else None,
            "rules": Rules(maximum_steps=200, layout="lab"),
            "players": players,
            "reason": "caught at 0.149 m" if step else "",
            "paused": not step,
            "request": "0f6c",
        },
        Tick: {"late": ("seeker",) if step else ()},
        Layout: {
            "obstacles": (
                Box(x=0.4, y=0.7, half_width=0.1, half_depth=0.05, heading=0.5),
                Box(x=0.9, y=0.2, half_width=0.06, half_depth=0.06),
            )
        },
        Pose: {"x": 0.25 + 0.01 * step, "y": 0.6, "heading": -1.5},
        Motion: {
            "primitive": "left" if step else "forward",
            "result": "stuck" if step else "completed",
            "distance_error": 0.006 if step else 0.001,
            "heading_error": -0.01,
            "elapsed": 0.2,
            "battery": 7.4,
            "reason": "wheels turn, the robot does not" if step else "",
        },
        Track: {
            "x": 0.25,
            "y": 0.6,
            "heading": -1.5,
            "speed_x": 0.04,
            "turn_rate": 0.5,
            "covariance": (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-4),
            "seen": not step,
        },
        DepthImage: {"width": 8, "height": 1, "intrinsics": lens, "data": np.arange(8, dtype="<u2").tobytes()},
        ColorImage: {"width": 8, "height": 1, "intrinsics": lens, "data": bytes(range(24))},
        Command: {"primitive": "left" if step else "forward"},
        StateImage: {"data": image, "other_x": 0.5 if step else None, "other_y": 0.25 if step else None},
        Plan: {
            "horizon": 200,
            "values": tuple(None if goal % 10 == 0 else goal / 10 for goal in range(GOAL_COUNT)),
            "goal": 7,
            "path": path.tobytes(),
            "elapsed": 0.75,
        },
        PredictRequest: {
            "state_image": image,
            "path_count": 1,
            "path_steps": 7,
            "paths": np.ascontiguousarray(path[:, :2]).tobytes(),
            "horizons": (3, 6),
            "views": ((0, 1),),
        },
        PredictReply: {
            "caught": np.array([0.25, 0.75], "<f4").tobytes(),
            "views": (bytes(3 * 128 * 128),),
            "weights": "0123456789abcdef",
            "distinct": 2,
            "elapsed": 0.01,
        },
        Control: {"action": "seek", "position": 12.5, "speed": 2.0}
        if step
        else {"action": "start", "seed": 42, "games": 2, "players": players, "request": "0f6c", "owner": "command-line"},
        Playback: {"log": "table-20261125.mcap", "position": 1.5, "duration": 30.0, "speed": 2.0, "state": "paused", "jumps": 1},
        Gap: {"key": "hider/pose", "publisher": "simulator", "missed": 2},
        Health: {
            "service": key.rpartition("/")[2],
            "state": "degraded",
            "process": 4711,
            "uptime": 12.5,
            "inputs": (
                InputHealth(key="hider/pose", publisher="simulator", received=40, lost=2, age=0.5),
                InputHealth(key="tick"),
            ),
            "unexpected": 1,
            "reason": "hider/pose from simulator is 5.0 s old, expected 4 a second",
        },
    }
    return kind(**common, **fields[kind])  # type: ignore[arg-type]


def write(path: Path) -> None:
    """Write two messages of every topic."""
    metadata = RunMetadata(commit="golden", arena="table", started=START)
    with LogWriter(path, metadata, sync=False) as log:
        for step in range(2):
            for place, (key, topic) in enumerate(TOPICS.items()):
                time = START + 250_000_000 * step + 1_000_000 * place
                payload = encode(example(key, step))
                log.write(key, payload, log_time=time, publish_time=time - 500_000, sequence=step, publisher=topic.publishers[0])


if __name__ == "__main__":
    target = GOLDEN / f"log_v{SCHEMA_VERSION}.mcap"
    write(target)
    print(f"{target}: {target.stat().st_size} bytes")
