"""The exported JSON Schemas are current, well formed, and say what the codec says."""

from pathlib import Path

import msgpack
import pytest
from jsonschema import Draft202012Validator

from comotion_schemas import MESSAGE_TYPES
from comotion_schemas.export import json_schemas, stale

ROOT = Path(__file__).parents[2]
GOLDEN = sorted((ROOT / "tests/golden").glob("*.msgpack"))


def validate(content):
    """Hold the header of an unpacked payload against the schema of its message."""

    def text(value):
        if isinstance(value, bytes):
            return value.decode("latin-1")
        if isinstance(value, list):
            return [text(item) for item in value]
        return {k: text(v) for k, v in value.items()} if isinstance(value, dict) else value

    name = content.get("schema", "comotion.ObservationBatch/1").removeprefix("comotion.").partition("/")[0]
    Draft202012Validator(json_schemas()[name]).validate(text(content))


def test_the_committed_schemas_are_current():
    assert stale(ROOT / "schemas") == []


@pytest.mark.parametrize("kind", MESSAGE_TYPES, ids=lambda kind: kind.__name__)
def test_a_schema_is_valid_and_names_every_field(kind):
    schema = json_schemas()[kind.__name__]
    Draft202012Validator.check_schema(schema)
    assert list(schema["properties"]) == list(kind.__dataclass_fields__)
    assert "\\z" not in str(schema)
    assert "null" not in str(schema)


@pytest.mark.parametrize("path", GOLDEN, ids=lambda path: path.stem)
def test_golden_messages_fulfil_their_schema(path):
    validate(msgpack.unpackb(path.read_bytes()))
