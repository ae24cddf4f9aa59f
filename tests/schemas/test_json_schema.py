"""JSON Schemas: valid, self-contained, true to what the codec accepts."""

from __future__ import annotations

import json

import jsonschema
import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas import Message, encode
from schemas.json_schema import json_schema, message_types, schema_hash
from tests.schemas.strategies import structs
from tests.schemas.test_codec import KINDS, QUICK, every_kind


@every_kind
def test_is_a_valid_schema_with_its_root_inlined(kind: type[Message]) -> None:
    document = json.loads(json_schema(kind))
    jsonschema.Draft202012Validator.check_schema(document)
    assert "$ref" not in document
    assert document["title"] == kind.__name__
    assert set(document["properties"]) == set(kind.__struct_fields__)


@every_kind
@QUICK
@given(data=st.data())
def test_messages_decoded_by_the_stock_msgpack_package_fulfil_it(kind: type[Message], data: st.DataObject) -> None:
    instance = msgpack.unpackb(encode(data.draw(structs(kind))))
    jsonschema.Draft202012Validator(json.loads(json_schema(kind))).validate(instance)


def test_it_refuses_what_the_codec_refuses() -> None:
    validator = jsonschema.Draft202012Validator(json.loads(json_schema(message_types()["Pose"])))
    for wrong in (
        {"x": 0.1},
        {"stamp": 1, "x": "here", "y": 0.0, "heading": 0.0},
        {"stamp": 1, "x": 1e6, "y": 0.0, "heading": 0.0},
    ):
        with pytest.raises(jsonschema.ValidationError):
            validator.validate(wrong)


def test_every_number_says_its_unit_or_is_a_count() -> None:
    unexplained = []
    for kind in KINDS:
        for name, field in json.loads(json_schema(kind))["properties"].items():
            if field.get("type") == "number" and "description" not in field:
                unexplained.append(f"{kind.__name__}.{name}")
    assert not unexplained


def test_the_hash_is_stable_within_a_version() -> None:
    assert len(schema_hash()) == 16
    assert schema_hash() == schema_hash()
