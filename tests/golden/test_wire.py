"""Golden bytes of every message, in both directions.

messages.json says what is in them, columns as their type and rows. The bytes were not made by the codec:
``python tests/golden/test_wire.py`` writes them with msgpack, as any other language would.
"""

import json
from pathlib import Path

import msgpack
import numpy as np
import pytest
from jsonschema import Draft202012Validator

from comotion_schemas import MESSAGE_TYPES, decode, encode
from comotion_schemas.export import json_schemas

HERE = Path(__file__).parent
GOLDEN = json.loads((HERE / "messages.json").read_text(encoding="utf-8"))


def written(value):
    """What another language would give to msgpack."""
    if isinstance(value, list):
        return [written(item) for item in value]
    if not isinstance(value, dict):
        return value
    if "column" in value:
        rows = np.array(value["rows"]).astype(value["column"]) if "nan" in str(value) else value["rows"]
        return np.array(rows, value["column"]).tobytes()
    return bytes.fromhex(value["hex"]) if "hex" in value else {k: written(v) for k, v in value.items()}


def as_in_file(value):
    """A message, or a part of one, as in the file; what is absent is left out."""
    if isinstance(value, np.ndarray):
        rows = value.tolist()
        return {"column": value.dtype.newbyteorder("<").str, "rows": json.loads(nan_as_text(rows))}
    if isinstance(value, list):
        return [as_in_file(item) for item in value]
    if isinstance(value, bytes):
        return {"hex": value.hex()}
    fields = {name: getattr(value, name) for name in getattr(value, "__dataclass_fields__", ())}
    fields = value if isinstance(value, dict) else fields
    return {k: as_in_file(v) for k, v in fields.items() if v is not None} if fields else value


def nan_as_text(rows):
    return json.dumps(rows).replace("NaN", '"nan"')


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


def test_every_message_type_is_there():
    schemas = {content["schema"] for content in GOLDEN.values()}
    assert schemas == {f"comotion.{kind.__name__}/1" for kind in MESSAGE_TYPES}
    assert {path.stem for path in HERE.glob("*.msgpack")} == set(GOLDEN)


@pytest.mark.parametrize("name", sorted(GOLDEN))
def test_golden_bytes_are_what_is_told_decode_to_it_and_are_encoded_again(name):
    raw = (HERE / f"{name}.msgpack").read_bytes()
    assert msgpack.packb(written(GOLDEN[name])) == raw
    validate(msgpack.unpackb(raw))
    message = decode(raw)
    assert as_in_file(message) == GOLDEN[name]
    assert encode(message) == raw


if __name__ == "__main__":
    for name, content in GOLDEN.items():
        (HERE / f"{name}.msgpack").write_bytes(msgpack.packb(written(content)))
