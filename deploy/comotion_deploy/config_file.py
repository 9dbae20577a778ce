"""The file given by ``--config``: defaults of options, and tables of its own.

In the file, common options are top-level keys, options of a command are in the table of its name
(``[serve]``, ``[source.simulator]``), fusion parameters in ``[fusion]``, and settings of the router in
``[zenoh]``.
"""

from pathlib import Path
from typing import Any

import typer

from .errors import UserError, one_line

COMMON = frozenset({"scene", "connect", "listen", "tls", "insecure", "log_level", "json"})
FREE_TABLES = frozenset({"fusion", "process", "zenoh"})
_MAX_BYTES = 1_000_000
_FILE = "comotion.config-file"


def read_config(ctx: typer.Context, path: Path | None) -> Path | None:
    """Take the defaults of a command's options from a file; the callback of ``--config``."""
    if path is None:
        return None
    content = load_toml(path)
    ctx.meta[_FILE] = content
    ctx.default_map = {**(ctx.default_map or {}), **_command_defaults(ctx, path, content)}
    return path


def load_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    UserError, InputError
        If the file cannot be read or is not valid TOML.
    """
    from comotion_sources.bounded import parse_toml, read_text

    text = read_text(path, _MAX_BYTES)
    try:
        return parse_toml(text)
    except ValueError as error:
        raise UserError(f"{path}: {one_line(error)}") from None


def _command_defaults(ctx: typer.Context, path: Path, content: dict[str, Any]) -> dict[str, Any]:
    """Return the values that a file has for the command of a context; a misspelt key is an error."""
    _check_top_level(ctx, path, content)
    options = {spelling(flag.lstrip("-")): option for option in ctx.command.params for flag in option.opts}
    # What the environment sets by another name is something else: a router connects to other routers.
    common = {
        name: value
        for name, value in _spelt(content).items()
        if name in COMMON & options.keys() and options[name].envvar in (None, f"COMOTION_{name.upper()}")
    }
    table: Any = content
    chunks = [chunk for chunk in ctx.command_path.split()[1:] if chunk != "dev"]
    for chunk in chunks:
        table = table.get(chunk, {})
        if not isinstance(table, dict):
            raise UserError(f"{path}: {chunk!r} must be a table")
    for key in table:
        if spelling(key) not in options:
            raise UserError(f"{path}: [{'.'.join(chunks)}] has no option {key!r}")
    return {str(options[name].name): value for name, value in (common | _spelt(table)).items()}


def _check_top_level(ctx: typer.Context, path: Path, content: dict[str, Any]) -> None:
    root = getattr(ctx.find_root().command, "commands", {})
    commands = root.keys() | getattr(root.get("dev"), "commands", {}).keys()
    for key, value in content.items():
        allowed = commands | FREE_TABLES if isinstance(value, dict) else COMMON
        if spelling(key) not in allowed and key not in allowed:
            what = "table" if isinstance(value, dict) else "common option"
            raise UserError(f"{path}: unknown {what} {key!r}; one of {', '.join(sorted(allowed))}")


def _spelt(table: dict[str, Any]) -> dict[str, Any]:
    return {spelling(key): value for key, value in table.items()}


def spelling(key: str) -> str:
    """Name of an option as Python spells it."""
    return key.replace("-", "_")


def file_table(ctx: typer.Context, name: str) -> dict[str, Any]:
    """Return a table of the configuration file that does not belong to a command; default: empty."""
    table: dict[str, Any] = ctx.meta.get(_FILE, {}).get(name, {})
    return table
