"""JSON Schema of every message type, and the hash that tells two sets of messages apart."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from typing import Any

import msgspec

from schemas.messages import Message
from schemas.topics import TOPICS


def _describe_bytes(node: Any) -> Any:
    """MessagePack carries bytes as bytes, not as the base64 text that JSON would need."""
    if isinstance(node, dict):
        if node.get("contentEncoding") == "base64":
            node = {name: value for name, value in node.items() if name not in ("type", "contentEncoding")}
            node["contentMediaType"] = "application/octet-stream"
            if node.get("default") == "":
                del node["default"]
        return {name: _describe_bytes(value) for name, value in node.items()}
    if isinstance(node, list):
        return [_describe_bytes(value) for value in node]
    return node


@cache
def json_schema(kind: type[Message]) -> bytes:
    """Return the JSON Schema (draft 2020-12) of a message type as it decodes from MessagePack, as UTF-8 text.

    The root stands at the top (PlotJuggler and Lichtblick do not follow a root `$ref`), nested types under `$defs`. A field
    of bytes has no `type`, only `contentMediaType`, because JSON has no bytes.
    """
    document = _describe_bytes(msgspec.json.schema(kind))
    definitions = document["$defs"]
    root = definitions.pop(document["$ref"].rsplit("/", 1)[1])
    if definitions:
        root["$defs"] = definitions
    document = {"$schema": "https://json-schema.org/draft/2020-12/schema", **root}
    return json.dumps(document, ensure_ascii=False, separators=(",", ":")).encode()


def message_types() -> dict[str, type[Message]]:
    """Return every message type of the topic table by its name."""
    return {topic.type.__name__: topic.type for topic in TOPICS.values()}


@cache
def schema_hash() -> str:
    """Return 16 hexadecimal digits that change whenever any message type changes."""
    digest = hashlib.sha256()
    for name, kind in sorted(message_types().items()):
        digest.update(name.encode())
        digest.update(json_schema(kind))
    return digest.hexdigest()[:16]
