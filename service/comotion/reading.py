"""Reads parameters as people write them; one error names what is wrong."""

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any

from pydantic import BaseModel, ValidationError

from comotion_schemas.errors import KnownError

from .config import FusionConfig


def read_config(values: Mapping[str, Any]) -> FusionConfig:
    """Build the parameters from names and values; those of a group nested, or as ``group.name``.

    Raises
    ------
    ValueError
        For an unknown name, with the one that is most like it, or a value out of bounds.
    """
    nested = {name: value for name, value in values.items() if "." not in name}
    for name in values.keys() - nested.keys():
        put(nested, name, values[name])
    try:
        return FusionConfig(**nested)
    except ValidationError as error:
        raise KnownError(_describe(error)) from None


def put(values: dict[str, Any], name: str, value: Any) -> None:
    """Set a parameter; ``group.name`` is one of a group, ``linking.cameras.NAME`` one camera."""
    *groups, last = name.split(".", 2)
    for group in groups:
        members = values.get(group)
        values[group] = dict(members) if isinstance(members, Mapping) else {}
        values = values[group]
    values[last] = value


def _describe(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    # What comes after a parameter's name is pydantic's; only cameras have names and members.
    depth = 4 if first["loc"][:1] == ("linking",) else 2
    name = ".".join(str(part) for part in first["loc"][:depth])
    if first["type"] == "extra_forbidden":
        return f"unknown fusion parameter {name!r}; {_suggestion(name)}"
    message = first["msg"].removeprefix("Value error, ")
    return f"fusion parameter {name}: {message}, got {first['input']!r}" if name else message


def _suggestion(name: str) -> str:
    """The parameter most like a misspelt one, of its group or of any."""
    group, _, last = name.rpartition(".")
    names = sorted(_parameter_names(FusionConfig), key=lambda full: full.rpartition(".")[0] == group)
    short = {full.rpartition(".")[2]: full for full in names}
    likely = get_close_matches(last, short, 1)
    return f"did you mean {short[likely[0]]}?" if likely else "see 'comotion config'"


def _parameter_names(model: type[BaseModel]) -> Iterator[str]:
    """Names of a model's parameters, those of a group as ``group.name``."""
    for name, field in model.model_fields.items():
        members = getattr(field.annotation, "model_fields", ())
        yield from (f"{name}.{member}" for member in members) if members else (name,)
