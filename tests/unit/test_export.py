"""The exported JSON Schemas are current, well formed, and say what the codec says."""

from pathlib import Path

import msgpack
import pytest
from jsonschema import Draft202012Validator, ValidationError

from comotion_schemas import MESSAGE_TYPES, DecodeError, decode
from comotion_schemas.export import export, json_schemas, main, stale

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


@pytest.mark.parametrize(
    "change",
    [
        {"colour": "red"},
        {"source": "Cam"},
        {"session": "0"},
        {"seq": -1},
        {"seq": "0"},
        {"dim": 4},
        {"unit": "mm"},
        {"sigma": 0.0},
        {"sigma": None},
        {"stamp_ns": 2**63},
        {"ids": [1]},
        {"schema": "comotion.ObservationBatch/2"},
    ],
    ids=str,
)
def test_what_the_schema_forbids_the_codec_rejects(change):
    content = msgpack.unpackb((ROOT / "tests/golden/observation-batch.msgpack").read_bytes()) | change
    with pytest.raises(ValidationError):
        validate(content)
    with pytest.raises(DecodeError):
        decode(msgpack.packb(content))


@pytest.mark.parametrize("field", ["schema", "source", "ids", "positions", "stamp_ns"])
def test_required_fields_are_required_by_both(field):
    content = msgpack.unpackb((ROOT / "tests/golden/observation-batch.msgpack").read_bytes())
    del content[field]
    with pytest.raises(ValidationError):
        validate(content)
    with pytest.raises(DecodeError):
        decode(msgpack.packb(content))


def test_the_check_fails_while_a_file_is_not_current(tmp_path, capsys):
    assert main([str(tmp_path), "--check"]) == 1
    assert "Status.schema.json is not current" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    assert main([str(tmp_path)]) == 0
    assert main([str(tmp_path), "--check"]) == 0
    (tmp_path / "Status.schema.json").write_text("{}")
    (tmp_path / "Gone.schema.json").write_text("{}")
    assert stale(tmp_path) == ["Gone.schema.json", "Status.schema.json"]
    assert main([str(tmp_path), "--check"]) == 1
    export(tmp_path)
    assert stale(tmp_path) == []


def test_a_folder_that_does_not_exist_is_an_error(tmp_path):
    with pytest.raises(SystemExit) as caught:
        main([str(tmp_path / "none")])
    assert caught.value.code == 2
