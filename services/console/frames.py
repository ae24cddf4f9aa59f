"""What goes to the page: `uint32 LE n | n bytes JSON header | payload`, each a piece of the present state named by its `key`.

The header is padded with spaces, so that the payload begins at a multiple of 8 bytes.
"""

from __future__ import annotations

from typing import Any

import msgspec

from schemas import ColorImage, DepthImage, Episode, Layout, Message, Plan, Playback, Pose, StateImage, Tick, Track

ALL = 0
"""Client number that stands for every page."""

_encode = msgspec.json.Encoder().encode


def frame(key: str, fields: dict[str, Any], payload: bytes = b"") -> bytes:
    """Return the bytes of one frame."""
    header = _encode({"key": key, **fields})
    header += b" " * (-(len(header) + 4) % 8)
    return b"".join((len(header).to_bytes(4, "little"), header, payload))


def addressed(client: int, data: bytes) -> bytes:
    """Return a frame with the number of the page it is for, as the page's device takes it."""
    return client.to_bytes(4, "little") + data


def notice(text: str, level: str = "error") -> bytes:
    """Return a frame that tells one page what came of its request. Level: info, warning or error."""
    return frame("notice", {"level": level, "text": text})


def frame_of(key: str, message: Message, **more: Any) -> bytes:
    """Return the frame that shows a message of the bus, with further fields.

    Raises:
        TypeError: messages of its type are not shown by themselves.
    """
    fields, payload = _shown(message)
    place = {"episode": message.episode, "step": message.step, "stamp": str(message.stamp)}
    return frame(key, {**place, **fields, **more}, payload)


def _shown(message: Message) -> tuple[dict[str, Any], bytes]:
    match message:
        case Pose(x=x, y=y, heading=heading):
            return {"x": x, "y": y, "heading": heading}, b""
        case Track(x=x, y=y, heading=heading, seen=seen):
            return {"x": x, "y": y, "heading": heading, "seen": seen}, b""
        case ColorImage() | DepthImage():
            camera = msgspec.to_builtins(message.intrinsics)
            return {"width": message.width, "height": message.height, "intrinsics": camera}, message.data
        case StateImage(other_x=x, other_y=y, data=data):
            return {"other_x": x, "other_y": y}, data
        case Tick():
            return {}, b""
        case Layout(width=width, depth=depth, obstacles=obstacles):
            return {"width": width, "depth": depth, "obstacles": obstacles}, b""
        case Episode():
            shown = ("seed", "phase", "rules", "outcome", "caught_step", "reason", "paused")
            # Whoever looks on need not know who plays: a name is for the log.
            players = {"hider": message.players.hider, "seeker": message.players.seeker}
            return {**{name: getattr(message, name) for name in shown}, "players": players}, b""
        case Plan():
            return {
                name: getattr(message, name) for name in ("horizon", "checkpoint_interval", "values", "goal", "elapsed")
            }, message.path
        case Playback():
            return {name: getattr(message, name) for name in ("log", "position", "duration", "speed", "state", "jumps")}, b""
    raise TypeError(f"{type(message).__name__} is not shown by itself")
