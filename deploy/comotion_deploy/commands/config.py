"""``comotion config``: the fusion parameters in effect."""

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, cast, get_args, get_origin

from ..fusion_options import Fusion
from ..options import Json, Tool

if TYPE_CHECKING:
    from pydantic import BaseModel


class Config(Fusion, Json, Tool):
    """Print the fusion parameters in effect, as TOML that --config reads (or JSON)."""

    epilog = """
Examples:
  comotion config --set thesis.sigma_switch=0.01 --set thesis.v_move=null
  comotion config --set rigid.looseness=0.4
  comotion config --json
  comotion config > my.toml   # then: comotion serve --config my.toml
"""

    def run(self) -> None:
        """Print them."""
        from comotion import FusionConfig

        values = self.fusion_config().model_dump(mode="json")
        self.show(values, *_table("fusion", FusionConfig, values))


def _table(name: str, model: "type[BaseModel]", values: dict[str, Any]) -> Iterator[str]:
    """Lines of the parameters of a model, those of nested ones as tables of their own after it."""
    yield f"[{name}]"
    nested = []
    for key, field in model.model_fields.items():
        if isinstance(values[key], dict):
            nested.append(key)
            continue
        yield f"# {field.description}"
        # JSON's strings, numbers and booleans are TOML's; only null is missing there.
        yield f"{key} = {json.dumps('null' if values[key] is None else values[key])}"
    for key in nested:
        field = model.model_fields[key]
        yield f"\n# {field.description}"
        if get_origin(field.annotation) is dict:
            # A map from names of the user's to models of one kind.
            for entry, content in values[key].items():
                yield from _table(f"{name}.{key}.{json.dumps(entry)}", get_args(field.annotation)[1], content)
        else:
            yield from _table(f"{name}.{key}", cast("type[BaseModel]", field.annotation), values[key])
