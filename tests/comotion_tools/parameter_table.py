"""Writes the tables of fusion parameters into a page of the documentation.

Usage: ``PYTHONPATH=tests python -m comotion_tools.parameter_table docs/parameters.md``.
"""

import json
import re
import sys
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from comotion import FusionConfig

_TABLE = re.compile(r"(<!-- table: (\w+) -->\n).*?(?=<!-- end -->)", re.DOTALL)
_GROUPS = {
    name: field.annotation
    for name, field in FusionConfig.model_fields.items()
    if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel)
}
_MODELS: dict[str, tuple[str, type[BaseModel]]] = {
    "FusionConfig": ("", FusionConfig),
    **{model.__name__: (f"{name}.", model) for name, model in _GROUPS.items()},
}
_UNBOUNDED = 1e9


def parameter_table(prefix: str, model: type[BaseModel]) -> str:
    """Markdown table of a model's parameters: name, default, what is allowed, description."""
    lines = ["| parameter | default | allowed | |", "|---|---|---|---|"]
    properties = model.model_json_schema()["properties"]
    for name, field in model.model_fields.items():
        if model is FusionConfig and name in _GROUPS:
            continue  # a group has a table of its own
        value = field.get_default(call_default_factory=True)
        default = "none" if value == {} else value if isinstance(value, str) else json.dumps(value)
        text = " ".join(str(field.description).split())
        lines.append(f"| `{prefix}{name}` | {default} | {_allowed(properties[name])} | {text} |")
    return "\n".join(lines) + "\n"


def _allowed(schema: dict[str, Any]) -> str:
    """Format the values that a JSON Schema allows."""
    if "anyOf" in schema:
        return " or ".join(_allowed(option) for option in schema["anyOf"])
    if "enum" in schema or "const" in schema:
        return ", ".join(schema.get("enum", [schema.get("const")]))
    if schema["type"] == "array":
        return f"list of {_allowed(schema.get('items') or schema['prefixItems'][0])}"
    if schema["type"] in {"null", "object"}:
        return {"null": "null", "object": "tables"}[schema["type"]]
    low = f"> {schema['exclusiveMinimum']:g}" if "exclusiveMinimum" in schema else ""
    if "minimum" in schema:
        low = "> 0" if schema["minimum"] == 1 / _UNBOUNDED else f"≥ {schema['minimum']:g}"
    high = ""
    for key, sign in (("maximum", "≤"), ("exclusiveMaximum", "<")):
        if schema.get(key, _UNBOUNDED) < _UNBOUNDED:
            high = f"{sign} {schema[key]:g}"
    return ", ".join(bound for bound in (low, high) if bound) or "any"


def filled(page: str) -> str:
    """Return the page with its tables replaced."""
    return _TABLE.sub(lambda found: found[1] + parameter_table(*_MODELS[found[2]]), page)


def main() -> None:
    """Update the tables of a page."""
    page = Path(sys.argv[1])
    page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
