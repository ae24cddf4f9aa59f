"""How messages may change over the years, so that every log ever written still reads.

* A field is added with a default; `SCHEMA_VERSION` goes up by one.
* A field is never removed: it is retired, that is moved to `RETIRED` with the version that dropped it, and neither its name
  nor its meaning comes back. Decoding skips it in old logs.
* A field never changes its type or unit: retire it and add another under a new name. Bounds and choices may widen.
* A topic is never removed from the log's reach: its type stays declared.

`violations` checks two descriptions of the messages against these rules; the test suite runs it on the committed one
(`python -m schemas.evolution` prints the present one).
"""

from __future__ import annotations

import json
from typing import Any

import msgspec

from schemas.json_schema import message_types

SCHEMA_VERSION = 4

RETIRED: dict[str, dict[str, int]] = {}
"""Type name -> field name -> the schema version that no longer has the field."""


def _type_text(kind: msgspec.inspect.Type) -> str:
    """A type without its bounds, as text that changes exactly when the encoding on the wire changes."""
    inspect = msgspec.inspect
    match kind:
        case inspect.Metadata(type=inner):
            return _type_text(inner)
        case inspect.UnionType(types=types):
            return " | ".join(sorted(_type_text(member) for member in types))
        case inspect.VarTupleType(item_type=item) | inspect.ListType(item_type=item):
            return f"[{_type_text(item)}]"
        case inspect.TupleType(item_types=items):
            return f"[{', '.join(_type_text(item) for item in items)}]"
        case inspect.StructType(cls=cls):
            return cls.__name__
        case inspect.LiteralType():
            return "choice"
        case _:
            return type(kind).__name__.removesuffix("Type").lower()


def _choices(kind: msgspec.inspect.Type) -> list[Any]:
    inspect = msgspec.inspect
    match kind:
        case inspect.Metadata(type=inner) | inspect.VarTupleType(item_type=inner):
            return _choices(inner)
        case inspect.LiteralType(values=values):
            return sorted(values)
        case inspect.UnionType(types=types):
            return [choice for member in types for choice in _choices(member)]
        case _:
            return []


def describe() -> dict[str, Any]:
    """Return every type reachable from the topic table: its fields, their types, choices and whether they are required."""
    inspect = msgspec.inspect
    types: dict[str, dict[str, Any]] = {}

    def visit(kind: msgspec.inspect.Type) -> None:
        match kind:
            case inspect.Metadata(type=inner):
                visit(inner)
            case inspect.UnionType(types=members) | inspect.TupleType(item_types=members):
                for member in members:
                    visit(member)
            case inspect.VarTupleType(item_type=item) | inspect.ListType(item_type=item):
                visit(item)
            case inspect.StructType(cls=cls, fields=fields) if cls.__name__ not in types:
                types[cls.__name__] = {}
                for field in fields:
                    entry: dict[str, Any] = {"type": _type_text(field.type), "required": field.required}
                    if choices := _choices(field.type):
                        entry["choices"] = choices
                    types[cls.__name__][field.encode_name] = entry
                    visit(field.type)
            case _:
                pass

    for message_type in message_types().values():
        visit(msgspec.inspect.type_info(message_type))
    return {"version": SCHEMA_VERSION, "types": dict(sorted(types.items()))}


def violations(old: dict[str, Any], new: dict[str, Any], retired: dict[str, dict[str, int]]) -> list[str]:
    """Return what in `new` would make a log written under `old` unreadable or misread; empty when all is well.

    Args:
        old: an earlier result of `describe`.
        new: the present result of `describe`.
        retired: the table `RETIRED` that belongs to `new`.
    """
    found: list[str] = []
    for name, old_fields in old["types"].items():
        gone = retired.get(name, {})
        if name not in new["types"]:
            found.append(f"{name}: the type vanished; keep it declared so that old logs decode")
            continue
        new_fields = new["types"][name]
        for field, was in old_fields.items():
            if field not in new_fields:
                if field not in gone:
                    found.append(f"{name}.{field}: vanished; list it in RETIRED")
                continue
            now = new_fields[field]
            if now["type"] != was["type"]:
                found.append(f"{name}.{field}: changed from {was['type']} to {now['type']}; retire it and add a new name")
            if now["required"] and not was["required"]:
                found.append(f"{name}.{field}: lost its default; old messages may lack it")
            missing = set(was.get("choices", ())) - set(now.get("choices", ()))
            if missing:
                found.append(f"{name}.{field}: no longer accepts {sorted(missing)}")
        found += [
            f"{name}.{field}: a new field needs a default"
            for field, now in new_fields.items()
            if field not in old_fields and now["required"]
        ]
    for name, gone in retired.items():
        found += [
            f"{name}.{field}: retired in version {version}, its name must not come back"
            for field, version in gone.items()
            if field in new["types"].get(name, {})
        ]
    if not found and new["types"] != old["types"] and new["version"] <= old["version"]:
        found.append(f"the messages changed: raise SCHEMA_VERSION above {old['version']}")
    return found


if __name__ == "__main__":
    print(json.dumps(describe(), indent=1))
