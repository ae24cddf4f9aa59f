"""Makes the worked examples of docs/robot-protocol.md: `python -m tests.drive.examples` writes them anew, a test compares."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable
from pathlib import Path

from schemas import CALLS, TOPICS, Command, Motion, Track, encode
from vantage.bus.zenoh_events import encoding_of, pack
from vantage.bus.zenoh_session import connections
from vantage.drive.protocol import (
    BUTTON,
    EMERGENCY_STOP,
    Acknowledgement,
    ClearEmergencyStop,
    EmergencyStop,
    Line,
    Query,
    SetSpeeds,
    Stop,
    Telemetry,
    checksum,
)
from vantage.drive.protocol import encode as encode_line

PAGE = Path(__file__).resolve().parents[2] / "docs" / "robot-protocol.md"
STARTED = 1_800_000_000_000_000_000
STAMP = STARTED + 12_345_678_900

EXCHANGE: tuple[tuple[str, Line], ...] = (
    ("driver", Query(0)),
    ("robot", Acknowledgement(0, 0)),
    ("robot", Telemetry(17, 340, 0, 0, 0, 8310, 0)),
    ("driver", SetSpeeds(1, 150, 150)),
    ("robot", Acknowledgement(1, 0)),
    ("robot", Telemetry(18, 360, 1, 23, 22, 8308, 0)),
    ("driver", SetSpeeds(2, -20, 35)),
    ("driver", Stop(3)),
    ("driver", EmergencyStop(4)),
    ("robot", Acknowledgement(4, EMERGENCY_STOP)),
    ("robot", Telemetry(19, 380, 4, 61, 70, 8305, EMERGENCY_STOP | BUTTON)),
    ("driver", ClearEmergencyStop(5)),
)

COMMAND = Command(stamp=STAMP, episode=3, step=41, primitive="forward")
MOTION = Motion(
    stamp=STAMP,
    episode=3,
    step=42,
    primitive="forward",
    result="completed",
    distance_error=0.00048828125,
    heading_error=-0.0078125,
    elapsed=0.3125,
    battery=7.5,
)


def dump(data: bytes) -> str:
    """Return bytes as `xxd` shows them."""
    rows = []
    for start in range(0, len(data), 16):
        row = data[start : start + 16]
        text = "".join(chr(byte) if 32 <= byte < 127 else "." for byte in row)
        rows.append(f"{start:04x}  {row.hex(' '):47s}  {text}")
    return "\n".join(rows)


def lines() -> str:
    rows = [f"{who + ':':8s} {encode_line(line).decode().rstrip()}" for who, line in EXCHANGE]
    return "```\n" + "\n".join(rows) + "\n```"


def line_bytes() -> str:
    data = encode_line(SetSpeeds(1, 150, 150))
    body = data[1:-6]
    return f"```\n{dump(data)}\n```\n\nThe checksum of `{body.decode()}` is 0x{checksum(body):04X}."


def command() -> str:
    return f"`{json.dumps(_fields(COMMAND))}`, encoding `{encoding_of(Command)}`:\n\n```\n{dump(encode(COMMAND))}\n```"


def motion() -> str:
    return f"`{json.dumps(_fields(MOTION))}`, encoding `{encoding_of(Motion)}`:\n\n```\n{dump(encode(MOTION))}\n```"


def attachment() -> str:
    data = pack(42, STAMP, struct.pack("<Q", STARTED) + b"onboard")
    return f"Sequence 42, published at {STAMP}, by `onboard`, which started at {STARTED}:\n\n```\n{dump(data)}\n```"


def track() -> str:
    return f"encoding `{encoding_of(Track)}`, fields " + ", ".join(f"`{name}`" for name in Track.__struct_fields__)


def gateway() -> str:
    known = {name for topic in TOPICS.values() for name in topic.publishers} | {call.server for call in CALLS.values()}
    peers = connections("onboard", Path(), frozenset(known))
    configuration = {
        "mode": "router",
        "listen": {"endpoints": ["unixsock-stream/FOLDER/onboard.sock", "tcp/ADDRESS:7447"]},
        "connect": {"endpoints": [f"unixsock-stream/FOLDER/{peer}.sock" for peer in peers], "exit_on_failure": False},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "timestamping": {"enabled": True},
        "transport": {"link": {"tx": {"lease": 10000, "keep_alive": 20}}},
    }
    return "```json\n" + json.dumps(configuration, indent=2) + "\n```"


EXAMPLES: dict[str, Callable[[], str]] = {
    function.__name__: function for function in (lines, line_bytes, command, motion, attachment, track, gateway)
}


def with_examples(text: str) -> str:
    """Return the page with every example between `<!-- made: NAME -->` and `<!-- end -->` made anew."""
    for name, make in EXAMPLES.items():
        pattern = rf"(<!-- made: {name} -->\n).*?(<!-- end -->)"
        text, count = re.subn(pattern, lambda found, make=make: found[1] + make() + "\n" + found[2], text, flags=re.DOTALL)  # type: ignore[misc]
        if count != 1:
            raise ValueError(f"{PAGE} must hold the example {name} once, it does {count} times")
    return text


def _fields(message: Command | Motion) -> dict[str, object]:
    return {name: getattr(message, name) for name in message.__struct_fields__}


if __name__ == "__main__":
    PAGE.write_text(with_examples(PAGE.read_text()))
