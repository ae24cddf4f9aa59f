"""The codec: every valid message survives it, nothing else gets through."""

from __future__ import annotations

import contextlib
from typing import Any

import msgpack
import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from schemas import TOPICS, MalformedMessage, Message, Pose, decode, encode
from schemas.json_schema import message_types
from tests.schemas.strategies import absurd, structs

KINDS = sorted(message_types().values(), key=lambda kind: kind.__name__)
QUICK = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])

every_kind = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)


def plain(value: Any) -> Any:
    """A message as MessagePack sees it: maps, lists and scalars."""
    if isinstance(value, msgspec.Struct):
        return {name: plain(getattr(value, name)) for name in value.__struct_fields__}
    if isinstance(value, dict):
        return {name: plain(item) for name, item in value.items()}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    return value


@every_kind
@QUICK
@given(data=st.data())
def test_round_trip_and_the_stock_msgpack_package_reads_the_same(kind: type[Message], data: st.DataObject) -> None:
    message = data.draw(structs(kind))
    payload = encode(message)
    assert decode(kind, payload) == message
    assert msgpack.unpackb(payload) == plain(message)


@every_kind
@QUICK
@given(data=st.data())
def test_what_the_stock_msgpack_package_writes_decodes(kind: type[Message], data: st.DataObject) -> None:
    message = data.draw(structs(kind))
    assert decode(kind, msgpack.packb(plain(message))) == message


@every_kind
@QUICK
@given(payload=st.binary(max_size=200))
def test_random_bytes_are_malformed_or_a_message(kind: type[Message], payload: bytes) -> None:
    try:
        message = decode(kind, payload)
    except MalformedMessage as error:
        text = str(error)
    else:
        assert isinstance(message, kind)
        return
    assert text.startswith(kind.__name__)


@every_kind
@QUICK
@given(data=st.data())
def test_absurd_values_are_malformed_or_within_bounds(kind: type[Message], data: st.DataObject) -> None:
    payload = msgpack.packb(plain(data.draw(absurd(kind))))
    try:
        message = decode(kind, payload)
    except MalformedMessage:
        return
    # What got through is within every bound: its own encoding decodes to it again (this would not hold for NaN).
    assert decode(kind, encode(message)) == message


@every_kind
@QUICK
@given(data=st.data())
def test_a_damaged_message_raises_nothing_else(kind: type[Message], data: st.DataObject) -> None:
    payload = bytearray(encode(data.draw(structs(kind))))
    place = data.draw(st.integers(0, len(payload) - 1))
    payload[place] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(payload)))
    for damaged in (bytes(payload), bytes(payload[:cut]), bytes(payload) + b"\x00"):
        with contextlib.suppress(MalformedMessage):
            decode(kind, damaged)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), float("-inf"), 1e9, "0.1", None])
def test_a_pose_is_somewhere(bad: Any) -> None:
    with pytest.raises(MalformedMessage):
        decode(Pose, msgpack.packb({"stamp": 1, "x": bad, "y": 0.0, "heading": 0.0}))


def test_unknown_fields_are_skipped_and_missing_ones_take_their_defaults() -> None:
    payload = msgpack.packb({"stamp": 5, "x": 0.1, "y": 0.2, "heading": 0.3, "from_the_future": [1, 2]})
    assert decode(Pose, payload) == Pose(stamp=5, episode=0, step=0, x=0.1, y=0.2, heading=0.3)


def test_deep_nesting_is_malformed() -> None:
    for topic in TOPICS.values():
        with pytest.raises(MalformedMessage):
            decode(topic.type, b"\x91" * 100_000)
