"""JSON Schema of every message header: ``python -m comotion_schemas.export [--check] DIR``.

The schemas describe the map in a payload. A column is a string with ``contentEncoding: binary``, and its
layout is in ``x-dtype`` and ``x-shape``. Rules about several fields are only in ``docs/protocol.md``.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from .codec import MESSAGE_TYPES, Message

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_SUFFIX = ".schema.json"
# Names of bounds that pydantic does not convert to JSON Schema in nested types.
_BOUNDS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}


def json_schema(kind: type[Message]) -> dict[str, Any]:
    """JSON Schema of one message type's header."""
    generated = TypeAdapter(kind).json_schema()
    content: dict[str, Any] = _as_on_the_wire(generated)
    # The schema name is a default in Python, but required in a payload.
    content["required"] = ["schema", *content["required"]]
    content["description"] = content["description"].partition("\n\nRaises\n")[0]
    return {"$schema": _DIALECT, "$id": f"comotion.{kind.__name__}/1"} | content


def json_schemas() -> dict[str, dict[str, Any]]:
    """Map message name -> JSON Schema of its header."""
    return {kind.__name__: json_schema(kind) for kind in MESSAGE_TYPES}


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
    return {
        f"{name}{_SUFFIX}": json.dumps(content, indent=2) + "\n" for name, content in json_schemas().items()
    }


def stale(folder: Path) -> list[str]:
    """List the files in a folder that are missing, outdated or do not belong to a message."""
    current = files()
    present = {path.name: path.read_text(encoding="utf-8") for path in folder.glob(f"*{_SUFFIX}")}
    return sorted(name for name in current | present if current.get(name) != present.get(name))


def export(folder: Path) -> None:
    """Write all schemas, and remove files that do not belong to a message."""
    for name in stale(folder):
        (folder / name).unlink(missing_ok=True)
    for name, content in files().items():
        (folder / name).write_text(content, encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status: 1 if the check finds outdated files."""
    parser = argparse.ArgumentParser(prog="python -m comotion_schemas.export", description=__doc__)
    parser.add_argument("folder", metavar="DIR", type=Path)
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a file is not current")
    options = parser.parse_args(arguments)
    if not options.folder.is_dir():
        parser.error(f"{options.folder} is not a directory")
    if not options.check:
        export(options.folder)
        return 0
    names = stale(options.folder)
    for name in names:
        sys.stderr.write(f"{options.folder / name} is not current; run: make schemas\n")
    return 1 if names else 0


if __name__ == "__main__":
    sys.exit(main())
