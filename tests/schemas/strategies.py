"""Hypothesis strategies: any valid message of a type, from the type itself."""

from __future__ import annotations

import struct
from typing import Any

import msgspec
from hypothesis import strategies as st
from msgspec import inspect as mi

from schemas import GOAL_COUNT, STATE_IMAGE_SIZE, Message

_BIG = STATE_IMAGE_SIZE * STATE_IMAGE_SIZE


def _bytes_of(size: int) -> st.SearchStrategy[bytes]:
    """Bytes of a size, repeated from a few, so that large images cost hypothesis little."""
    return st.binary(min_size=1, max_size=16).map(lambda seed: (seed * (size // len(seed) + 1))[:size])


def values(kind: mi.Type) -> st.SearchStrategy[Any]:
    """Any value of a type within its bounds."""
    match kind:
        case mi.Metadata(type=inner):
            return values(inner)
        case mi.UnionType(types=types):
            return st.one_of([values(member) for member in types])
        case mi.VarTupleType(item_type=item, min_length=low, max_length=high):
            return st.lists(values(item), min_size=low or 0, max_size=min(high or 4, (low or 0) + 4)).map(tuple)
        case mi.TupleType(item_types=items):
            return st.tuples(*(values(item) for item in items))
        case mi.IntType(ge=low, gt=_, le=high, lt=below):
            return st.integers(low, high if high is not None else (below - 1 if below is not None else None))
        case mi.FloatType(ge=low, gt=above, le=high):
            bound = low if low is not None else above
            exclude = low is None and above is not None
            return st.floats(bound, high, exclude_min=exclude, allow_nan=False, allow_infinity=False)
        case mi.StrType(max_length=longest):
            return st.text(max_size=min(longest or 20, 20))
        case mi.BytesType():
            return st.binary(max_size=32)
        case mi.BoolType():
            return st.booleans()
        case mi.NoneType():
            return st.none()
        case mi.LiteralType(values=choices):
            return st.sampled_from(choices)
        case mi.StructType(cls=cls):
            return structs(cls)
    raise NotImplementedError(kind)


def structs(kind: type[msgspec.Struct]) -> st.SearchStrategy[Any]:
    """Any valid struct: fields by their types, then what the type demands across fields."""
    info = mi.type_info(kind)
    assert isinstance(info, mi.StructType)
    fields = st.fixed_dictionaries({field.name: values(field.type) for field in info.fields})

    @st.composite
    def build(draw: st.DrawFn) -> Any:
        chosen = draw(fields)
        match kind.__name__:
            case "DepthImage" | "ColorImage":
                chosen["width"], chosen["height"] = draw(st.integers(1, 64)), draw(st.integers(1, 8))
                pixel = 2 if kind.__name__ == "DepthImage" else 3
                chosen["data"] = draw(_bytes_of(pixel * chosen["width"] * chosen["height"]))
            case "StateImage":
                chosen["data"] = draw(_bytes_of(_BIG))
            case "Rules":
                low, high = sorted((chosen["start_distance_minimum"], chosen["start_distance_maximum"]))
                chosen["start_distance_minimum"], chosen["start_distance_maximum"] = low, high
            case "Plan":
                value = st.none() | st.floats(0, 1e6)
                chosen["values"] = draw(st.just(()) | st.lists(value, min_size=GOAL_COUNT, max_size=GOAL_COUNT).map(tuple))
                chosen["path"] = draw(st.integers(0, 5).flatmap(lambda n: _bytes_of(12 * n) if n else st.just(b"")))
            case "PredictRequest":
                chosen["state_image"] = draw(_bytes_of(_BIG))
                chosen["path_count"], chosen["path_steps"] = draw(st.integers(1, 3)), draw(st.integers(1, 6))
                chosen["paths"] = draw(_bytes_of(8 * chosen["path_count"] * chosen["path_steps"]))
                horizons = st.lists(st.integers(0, chosen["path_steps"] - 1), min_size=1, max_size=3)
                chosen["horizons"] = tuple(draw(horizons))
                pair = st.tuples(st.integers(0, chosen["path_count"] - 1), st.integers(0, len(chosen["horizons"]) - 1))
                chosen["views"] = tuple(draw(st.lists(pair, max_size=3)))
            case "PredictReply":
                chances = draw(st.lists(st.floats(0, 1, width=32), max_size=5))
                chosen["caught"] = struct.pack(f"<{len(chances)}f", *chances)
                chosen["views"] = tuple(draw(st.lists(_bytes_of(3 * _BIG), max_size=1)))
        return kind(**chosen)

    return build()


def absurd(kind: type[Message]) -> st.SearchStrategy[dict[str, Any]]:
    """Maps with the fields of a type (or some of them) and values that make little sense."""
    info = mi.type_info(kind)
    assert isinstance(info, mi.StructType)
    nonsense = st.recursive(
        st.none()
        | st.booleans()
        | st.integers(-(2**63), 2**64 - 1)
        | st.floats()
        | st.text(max_size=8)
        | st.binary(max_size=8)
        | st.sampled_from(("forward", "running", "hider", "\ud7ff", "x" * 3000)),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
        max_leaves=5,
    )
    field = {field.name: values(field.type) | nonsense for field in info.fields}
    return st.fixed_dictionaries({}, optional=field)
