"""The fusion parameters that a command line and its configuration file give."""

import json
from typing import TYPE_CHECKING, Any

import typer

from .errors import UserError
from .options import file_table, spelling

if TYPE_CHECKING:
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
    from comotion.config import put, read_config

    table = _read_null(file_table(ctx, "fusion"))
    values = {spelling(name): value for name, value in table.items()}
    if method is not None:
        values["method"] = method
    for text in assignments or ():
        name, value = _assignment(text)
        put(values, name, value)
    try:
        return read_config(values)
    except ValueError as error:
        raise UserError(str(error)) from None


def _read_null(value: Any) -> Any:
    """None for TOML's "null", in tables too."""
    if isinstance(value, dict):
        return {key: _read_null(content) for key, content in value.items()}
    return None if value == "null" else value


def _assignment(text: str) -> tuple[str, Any]:
    name, separator, value = text.partition("=")
    if not separator or not name:
        raise UserError(f"--set {text}: expected NAME=VALUE")
    try:
        return spelling(name.strip()), json.loads(value)
    except ValueError:
        return spelling(name.strip()), value
