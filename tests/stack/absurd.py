"""Messages that nobody in his right mind would send: random bytes, and well-shaped nonsense made from the schemas."""

from __future__ import annotations

import random
from typing import Any

import msgpack
import msgspec

from schemas import ColorImage, DepthImage, Message, PredictRequest, StateImage

_NUMBERS = (0, 1, -1, 2**31, 2**63 - 1, 2**64 - 1, -(2**63), 100_000, 0.5, -100.0, 1e9, 1e308, -1e308, float("nan"), float("inf"))
_THINGS: tuple[Any, ...] = (
    None,
    True,
    "",
    "vantage",
    "ä" * 500,
    b"",
    b"\0" * 100,
    [],
    {},
    [[[[[]]]]],
    {"a": {"b": 1}},
    *_NUMBERS,
)


def random_bytes(source: random.Random) -> bytes:
    """Bytes that are no message: too short for one, but often the beginning of MessagePack."""
    length = source.randrange(0, 40)
    first = source.choice(
        (b"", b"\x80", b"\x8f", b"\xde\xff\xff", b"\xdd\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff", b"\x93", b"\xc1")
    )
    return first + source.randbytes(length)


def shaped(kind: type[Message], source: random.Random) -> bytes:
    """A map with the fields of `kind`; about half of the messages are within all bounds, and nonsense all the same."""
    wild = source.random() < 0.5
    fields = _struct(msgspec.inspect.type_info(kind), source)
    _make_sizes_agree(kind, fields, source)
    if wild:
        name = source.choice(sorted(fields))
        what = source.randrange(3)
        if what == 0:
            del fields[name]
        elif what == 1:
            fields[name] = source.choice(_THINGS)
        else:
            fields["nobody knows this field"] = source.choice(_THINGS)
    packed: bytes = msgpack.packb(fields)
    return packed


def _make_sizes_agree(kind: type[Message], fields: dict[str, Any], source: random.Random) -> None:
    """Give arrays the length that other fields ask for, so that nonsense gets past the door."""
    if kind in (DepthImage, ColorImage):
        width, height = source.choice(((1, 1), (128, 1), (1, 128), (64, 48)))
        fields |= {"width": width, "height": height, "data": source.randbytes(width * height * (2 if kind is DepthImage else 3))}
    elif kind is StateImage:
        fields["data"] = source.choice((b"\xff" * 128 * 128, source.randbytes(128 * 128)))
    elif kind is PredictRequest:
        count, steps = source.randint(1, 3), source.randint(1, 30)
        fields |= {"path_count": count, "path_steps": steps, "paths": source.randbytes(8 * count * steps)}
        fields |= {"state_image": source.randbytes(128 * 128), "horizons": [source.randrange(steps)], "views": []}


def _struct(info: Any, source: random.Random) -> dict[str, Any]:
    fields = {}
    for field in info.fields:
        if field.required or source.random() < 0.7:
            fields[field.encode_name] = _value(field.type, source)
    return fields


def _value(info: Any, source: random.Random) -> Any:
    inspect = msgspec.inspect
    if isinstance(info, inspect.Metadata):
        return _value(info.type, source)
    if isinstance(info, inspect.StructType):
        return _struct(info, source)
    if isinstance(info, inspect.LiteralType):
        return source.choice(info.values)
    if isinstance(info, inspect.UnionType):
        return _value(source.choice(info.types), source)
    if isinstance(info, inspect.IntType):
        low = 0 if info.ge is None else info.ge
        high = 2**63 - 1 if info.le is None and info.lt is None else info.le if info.le is not None else info.lt - 1
        return source.choice((low, high, source.randint(low, high), min(high, low + source.randrange(50))))
    if isinstance(info, inspect.FloatType):
        low = info.ge if info.ge is not None else 0.001 if info.gt is not None else -1e308
        high = info.le if info.le is not None else 1e308
        return source.choice((float(low), float(high), source.uniform(max(low, -1e6), min(high, 1e6))))
    if isinstance(info, inspect.BoolType):
        return source.random() < 0.5
    if isinstance(info, inspect.StrType):
        return source.choice(
            ("", "planner", "glancing", "no such thing", "/dev/null", "../../etc", "x" * (info.max_length or 50))
        )
    if isinstance(info, inspect.BytesType):
        return source.choice((b"", b"\xff" * 12, b"\0" * 128 * 128, source.randbytes(24)))
    if isinstance(info, inspect.VarTupleType | inspect.ListType):
        return [_value(info.item_type, source) for _ in range(min(source.choice((0, 1, 2, 121)), info.max_length or 121))]
    if isinstance(info, inspect.TupleType):
        return [_value(item, source) for item in info.item_types]
    assert isinstance(info, inspect.NoneType), info
    return None
