"""JSON Schema of every message header; ``python -m comotion_schemas.export DIR`` writes them.

The schemas describe the map in a payload. A column is a string with ``contentEncoding: binary``, and its
layout is in ``x-dtype`` and ``x-shape``. Rules about several fields are only in ``docs/protocol.md``.
"""

import json
import sys
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from .codec import MESSAGE_TYPES

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
# Names of bounds that pydantic does not convert to JSON Schema in nested types.
_BOUNDS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}


@cache
def json_schemas() -> dict[str, dict[str, Any]]:
    """Map message name -> JSON Schema of its header."""
    schemas = {}
    for kind in MESSAGE_TYPES:
        content = _as_on_the_wire(TypeAdapter(kind).json_schema())
        # The schema name is a default in Python, but required in a payload.
        content["required"] = ["schema", *content["required"]]
        schemas[kind.__name__] = {"$schema": _DIALECT, "$id": f"comotion.{kind.__name__}/1"} | content
    return schemas


def _as_on_the_wire(node: Any) -> Any:
    """Convert to the protocol: optional fields are absent, not null; patterns in ECMA syntax."""
    if isinstance(node, list):
        return [_as_on_the_wire(item) for item in node]
    if not isinstance(node, dict):
        return node
    result = {
        str(_BOUNDS.get(key, key)).replace(r"\z", "$"): _as_on_the_wire(value)
        for key, value in node.items()
        if not (key == "default" and (value is None or "const" in node))
    }
    if isinstance(result.get("pattern"), str):
        result["pattern"] = result["pattern"].replace(r"\z", "$")
    choices = result.get("anyOf")
    if choices:
        kept = [choice for choice in choices if choice != {"type": "null"}]
        if len(kept) == 1:
            del result["anyOf"]
            return result | kept[0]
        result["anyOf"] = kept
    return result


def files() -> dict[str, str]:
    """Map file name -> content of every exported file."""
    return {f"{name}.schema.json": json.dumps(text, indent=2) + "\n" for name, text in json_schemas().items()}


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    for old in folder.glob("*.schema.json"):
        old.unlink()
    for name, content in files().items():
        (folder / name).write_text(content, encoding="utf-8")
