"""Options that every command shares, and where their values come from.

A flag beats ``COMOTION_*`` in the environment, which beats the file given by ``--config``, which
beats the default. In the file, common options are top-level keys, the options of a command are in
a table of its name (``[serve]``, ``[source.simulator]``), the fusion parameters in ``[fusion]``,
settings of the router in ``[zenoh]``.
"""

import logging
import sys
import tomllib
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .errors import UserError, missing_extra, one_line

if TYPE_CHECKING:
    from comotion_schemas.transport import SessionSettings

COMMON = frozenset({"scene", "connect", "listen", "log_level", "json"})
FREE_TABLES = frozenset({"fusion", "process", "zenoh"})
_FILE = "comotion.config-file"


class LogLevel(StrEnum):
    """How much a process tells on standard error."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


def _read_config(ctx: typer.Context, path: Path | None) -> Path | None:
    if path is None:
        return None
    content = load_toml(path)
    ctx.meta[_FILE] = content
    ctx.default_map = {**(ctx.default_map or {}), **command_defaults(ctx, path, content)}
    return path


def _start_logging(ctx: typer.Context, level: LogLevel) -> LogLevel:
    if not ctx.resilient_parsing:
        logging.basicConfig(level=level.upper(), format="%(levelname)s: %(message)s")
    return level


def _expose_metrics(ctx: typer.Context, address: str | None) -> str | None:
    if address is None or ctx.resilient_parsing:
        return address
    from comotion_schemas import metrics

    host, port = metrics.parse_address(address)
    try:
        port = metrics.expose(host, port)
    except ImportError as error:
        raise missing_extra("metrics", error) from None
    # Not logged: the level of logging may not be known yet.
    print(f"metrics at http://{host}:{port}/metrics", file=sys.stderr, flush=True)
    return address


Scene = Annotated[
    str, typer.Option("--scene", envvar="COMOTION_SCENE", help="Scene: one service and its sources.")
]
Connect = Annotated[
    list[str] | None,
    typer.Option(
        "--connect",
        envvar="COMOTION_CONNECT",
        metavar="ENDPOINT",
        help="Router to connect to; may be repeated. Default: tcp/127.0.0.1:7447.",
    ),
]
Listen = Annotated[
    list[str] | None,
    typer.Option(
        "--listen",
        envvar="COMOTION_LISTEN",
        metavar="ENDPOINT",
        help="Be a router as well, at this endpoint; may be repeated.",
    ),
]
ConfigFile = Annotated[
    Path | None,
    typer.Option(
        "--config",
        envvar="COMOTION_CONFIG",
        metavar="FILE.toml",
        is_eager=True,
        callback=_read_config,
        help="Read options from a TOML file.",
    ),
]
Log = Annotated[
    LogLevel,
    typer.Option(
        "--log-level",
        envvar="COMOTION_LOG_LEVEL",
        callback=_start_logging,
        help="How much to tell on standard error.",
    ),
]
Json = Annotated[bool, typer.Option("--json", envvar="COMOTION_JSON", help="Print the result as JSON.")]
Metrics = Annotated[
    str | None,
    typer.Option(
        "--metrics-port",
        envvar="COMOTION_METRICS_PORT",
        metavar="[HOST:]PORT",
        callback=_expose_metrics,
        help="Serve Prometheus metrics, on 127.0.0.1 unless a host is given; 0 takes a free port.",
    ),
]
ReadyFile = Annotated[
    Path | None,
    typer.Option(
        "--ready-file",
        envvar="COMOTION_READY_FILE",
        metavar="PATH",
        help="Write this file once serving, instead of printing 'ready'.",
    ),
]
Method = Annotated[
    str | None,
    typer.Option("--method", envvar="COMOTION_METHOD", help="How hypotheses are inferred, e.g. thesis."),
]
Assignments = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        envvar="COMOTION_SET",
        metavar="NAME=VALUE",
        help="Set a fusion parameter; may be repeated. 'null' is None; see 'comotion config'.",
    ),
]


def load_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    UserError
        If it cannot be read or is no TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: {one_line(error)}") from None


def command_defaults(ctx: typer.Context, path: Path, content: dict[str, Any]) -> dict[str, Any]:
    """Pick what a configuration file says about the command of a context.

    Raises
    ------
    UserError
        For a key that no command knows: a misspelt option must not pass in silence.
    """
    _check_top_level(ctx, path, content)
    known = _parameters(ctx)
    common = {
        known[name]: value for key, value in content.items() if (name := spelling(key)) in COMMON & set(known)
    }
    return common | _command_table(ctx, path, content, known)


def _parameters(ctx: typer.Context) -> dict[str, str]:
    """Names of a command's options as a file spells them, and as its function does."""
    known = {}
    for parameter in ctx.command.params:
        for given in parameter.opts:
            if parameter.name:
                known[spelling(given.lstrip("-"))] = parameter.name
    return known


def _check_top_level(ctx: typer.Context, path: Path, content: dict[str, Any]) -> None:
    commands = set(getattr(ctx.find_root().command, "commands", {}))
    for key, value in content.items():
        allowed = commands | FREE_TABLES if isinstance(value, dict) else COMMON
        if spelling(key) not in allowed and key not in allowed:
            what = "table" if isinstance(value, dict) else "common option"
            raise UserError(f"{path}: unknown {what} {key!r}; one of {', '.join(sorted(allowed))}")


def _command_table(
    ctx: typer.Context, path: Path, content: dict[str, Any], known: dict[str, str]
) -> dict[str, Any]:
    table: Any = content
    chunks = ctx.command_path.split()[1:]
    for chunk in chunks:
        table = table.get(chunk, {})
        if not isinstance(table, dict):
            raise UserError(f"{path}: {chunk!r} must be a table")
    for key in table:
        if spelling(key) not in known:
            raise UserError(f"{path}: [{'.'.join(chunks)}] has no option {key!r}")
    return {known[spelling(key)]: value for key, value in table.items()}


def spelling(key: str) -> str:
    """Name of an option as functions spell it."""
    return key.replace("-", "_")


def file_table(ctx: typer.Context, name: str) -> dict[str, Any]:
    """Read a table of the configuration file that belongs to no command; empty without one."""
    table: dict[str, Any] = ctx.meta.get(_FILE, {}).get(name, {})
    return table


def session_settings(connect: list[str] | None, listen: list[str] | None = None) -> "SessionSettings":
    """Build the session settings of the common options.

    A process that listens is a router itself, and connects elsewhere only when told to.
    """
    from comotion_schemas.transport import SessionSettings

    if listen:
        return SessionSettings(mode="router", connect=tuple(connect or ()), listen=tuple(listen))
    return SessionSettings(connect=tuple(connect)) if connect else SessionSettings()
