"""The fusion parameters that a command line and its configuration file give."""

import json
from collections.abc import Iterator
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

import typer

from .errors import UserError
from .options import file_table, spelling

if TYPE_CHECKING:
    from pydantic import BaseModel

    from comotion import FusionConfig


def fusion_config(
    ctx: typer.Context, method: str | None = None, assignments: list[str] | None = None
) -> "FusionConfig":
    """Build the fusion parameters: ``[fusion]`` of the file, then ``--method``, then ``--set``.

    Raises
    ------
    UserError
        For an unknown parameter or a value out of bounds.
    """
    from pydantic import ValidationError

    from comotion import FusionConfig

    table = _read_null(file_table(ctx, "fusion"))
    values = {spelling(name): value for name, value in table.items()}
    if method is not None:
        values["method"] = method
    for text in assignments or ():
        name, value = _assignment(text)
        _set(values, name, value)
    try:
        return FusionConfig(**values)
    except ValidationError as error:
        raise UserError(_describe(error, FusionConfig)) from None


def _read_null(value: Any) -> Any:
    """None for TOML's "null", in tables too."""
    if isinstance(value, dict):
        return {key: _read_null(content) for key, content in value.items()}
    return None if value == "null" else value


def _set(values: dict[str, Any], name: str, value: Any) -> None:
    """Set a parameter; ``group.name`` is one of a group, ``linking.cameras.NAME`` one camera."""
    *groups, last = name.split(".", 2)
    for group in groups:
        before = values.get(group)
        values[group] = dict(before) if isinstance(before, dict) else {}
        values = values[group]
    values[last] = value


def _assignment(text: str) -> tuple[str, Any]:
    name, separator, value = text.partition("=")
    if not separator or not name:
        raise UserError(f"--set {text}: expected NAME=VALUE")
    try:
        return spelling(name.strip()), json.loads(value)
    except ValueError:
        return spelling(name.strip()), value


def _describe(error: Any, model: "type[BaseModel]") -> str:
    first = error.errors(include_url=False)[0]
    # What comes after a parameter's name is pydantic's; only cameras have names and members.
    depth = 4 if first["loc"][0] == "linking" else 2
    name = ".".join(str(part) for part in first["loc"][:depth])
    if first["type"] == "extra_forbidden":
        return f"unknown fusion parameter {name!r}; {_suggestion(name, model)}"
    return f"fusion parameter {name}: {first['msg']}, got {first['input']!r}"


def _suggestion(name: str, model: "type[BaseModel]") -> str:
    """The parameter most like a misspelt one, of its group or of any."""
    known = list(_parameter_names(model))
    short = {full.rpartition(".")[2]: full for full in known}
    last = name.rpartition(".")[2]
    if last in short:
        return f"did you mean {short[last]}?"
    found = get_close_matches(name, known, 1) or get_close_matches(last, short, 1)
    return f"did you mean {short.get(found[0], found[0])}?" if found else "see 'comotion config'"


def _parameter_names(model: "type[BaseModel]") -> Iterator[str]:
    """Names of a model's parameters, those of a group as ``group.name``."""
    for name, field in model.model_fields.items():
        members = getattr(field.annotation, "model_fields", ())
        yield from (f"{name}.{member}" for member in members) if members else (name,)
