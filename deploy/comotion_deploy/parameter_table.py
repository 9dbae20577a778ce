"""The tables of fusion parameters in a page of the documentation.

Written by ``python -m comotion_deploy.parameter_table docs/parameters.md``.
"""

import re
import sys
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from comotion import FusionConfig
from comotion.rigid.config import MotionConfig

_TABLE = re.compile(r"(<!-- table: (\w+) -->\n).*?(?=<!-- end -->)", re.DOTALL)
_MODELS: dict[str, tuple[str, type[BaseModel]]] = {
    "FusionConfig": ("", FusionConfig),
    "MotionConfig": ("motion.", MotionConfig),
}
_UNBOUNDED = 1e9


def parameter_table(prefix: str, model: type[BaseModel]) -> str:
    """Markdown table of a model's parameters: name, default, what is allowed, description."""
    lines = ["| parameter | default | allowed | |", "|---|---|---|---|"]
    properties = model.model_json_schema()["properties"]
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            continue  # a group has a table of its own
        value = field.get_default(call_default_factory=True)
        default = "null" if value is None else "none" if value == {} else value
        lines.append(f"| `{prefix}{name}` | {default} | {_allowed(properties[name])} | {field.description} |")
    return "\n".join(lines) + "\n"


def _allowed(schema: dict[str, Any]) -> str:
    """What a JSON Schema admits, in words."""
    if "anyOf" in schema:
        return " or ".join(_allowed(option) for option in schema["anyOf"])
    if "enum" in schema or "const" in schema:
        return ", ".join(schema.get("enum", [schema.get("const")]))
    if schema["type"] in {"null", "object"}:
        return {"null": "null", "object": "tables"}[schema["type"]]
    low = f"> {schema['exclusiveMinimum']:g}" if "exclusiveMinimum" in schema else ""
    if schema.get("minimum", 0) > 1 / _UNBOUNDED or schema.get("minimum") == 0:
        low = f"≥ {schema['minimum']:g}"
    high = ""
    for key, sign in (("maximum", "≤"), ("exclusiveMaximum", "<")):
        if schema.get(key, _UNBOUNDED) < _UNBOUNDED:
            high = f"{sign} {schema[key]:g}"
    return ", ".join(bound for bound in (low or "> 0", high) if bound)


def filled(page: str) -> str:
    """Write the page anew, its tables as the code has them."""
    return _TABLE.sub(lambda found: found[1] + parameter_table(*_MODELS[found[2]]), page)


def main() -> None:
    """Bring the tables of a page in step."""
    page = Path(sys.argv[1])
    page.write_text(filled(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
