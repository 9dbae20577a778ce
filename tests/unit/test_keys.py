"""Keys and quality of service are those of the protocol; exported schemas say what the codec says."""

from pathlib import Path

import msgpack
import pytest
from jsonschema import Draft202012Validator

from comotion_schemas import MESSAGE_TYPES, QOS, Keys
from comotion_schemas.export import files, json_schemas


def test_keys_are_those_of_the_protocol():
    keys = Keys("lab")
    assert Keys().prefix == "comotion/@v1/default"
    assert keys.stream("obs", "cam-1") == "comotion/@v1/lab/obs/cam-1"
    assert keys.streams("truth") == "comotion/@v1/lab/truth/*"
    assert keys.hypotheses == "comotion/@v1/lab/hypotheses"
    assert keys.live("source", "cam-1") == "comotion/@v1/lab/live/source/cam-1"
    assert keys.all_live() == "comotion/@v1/lab/live/*/*"
    assert keys.query("affinity") == "comotion/@v1/lab/query/affinity"


@pytest.mark.parametrize("name", ["", "A", "a/b", "a b", "ä", "a\n", "*", "$*", "@v1", "x" * 65])
def test_a_name_is_one_chunk_of_plain_characters(name):
    with pytest.raises(ValueError, match="1 to 64 characters"):
        Keys(name)
    with pytest.raises(ValueError, match="1 to 64 characters"):
        Keys().stream("obs", name)
    with pytest.raises(ValueError, match="1 to 64 characters"):
        Keys().live("source", name)


def test_every_message_has_one_quality_of_service():
    assert sorted(qos.message for qos in QOS.values()) == sorted(kind.__name__ for kind in MESSAGE_TYPES)
    assert QOS["obs"].encoding == "application/msgpack;comotion.ObservationBatch/1"
    # A late joiner gets the last update and all truths, but no observations of the past.
    assert QOS["hypotheses"].cache == 1
    assert QOS["truth"].cache > 1000
    assert QOS["obs"].cache == 0


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
    assert {path.name: path.read_text() for path in ROOT.glob("schemas/*.schema.json")} == files()


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
