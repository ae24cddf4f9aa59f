"""MessagePack on the wire: encode, and decode with validation by type."""

from __future__ import annotations

from functools import cache
from typing import TypeVar

import msgspec

from schemas.messages import Message

AnyMessage = TypeVar("AnyMessage", bound=Message)

_encoder = msgspec.msgpack.Encoder()


class MalformedMessage(ValueError):
    """The bytes are not a valid message of the expected type."""


@cache
def _decoder(kind: type[Message]) -> msgspec.msgpack.Decoder[Message]:
    return msgspec.msgpack.Decoder(kind)


def encode(message: Message) -> bytes:
    """Return the MessagePack bytes of a message: a map from field name to value."""
    return _encoder.encode(message)


def decode(kind: type[AnyMessage], payload: bytes) -> AnyMessage:
    """Return the message of type `kind` held by `payload`.

    Unknown fields are skipped (a newer publisher), missing ones take their defaults (an older log).

    Raises:
        MalformedMessage: the bytes are not MessagePack, or a field is missing, of a wrong type or out of bounds.
    """
    try:
        return _decoder(kind).decode(payload)  # type: ignore[return-value]
    except (msgspec.MsgspecError, UnicodeDecodeError, ValueError, OverflowError, RecursionError) as error:
        raise MalformedMessage(f"{kind.__name__}: {error}") from error
