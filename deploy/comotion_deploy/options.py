"""Common options of the commands, and the sources of their values.

A flag takes precedence over ``COMOTION_*`` in the environment, the environment over the file given by
``--config``, and the file over the default. In the file, common options are top-level keys, options of a
command are in the table of its name (``[serve]``, ``[source.simulator]``), fusion parameters in
``[fusion]``, and settings of the router in ``[zenoh]``.
"""

import logging
import re
import socket
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from .errors import UserError, missing_extra, one_line
from .network import OPEN_METRICS, require_closed, session_settings

__all__ = ["session_settings"]

COMMON = frozenset({"scene", "connect", "listen", "tls", "insecure", "log_level", "json"})
FREE_TABLES = frozenset({"fusion", "process", "zenoh"})
_MAX_BYTES = 1_000_000
_FILE = "comotion.config-file"


class LogLevel(StrEnum):
    """Least severity of messages on standard error."""

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
        from comotion_schemas.text import LogFormatter

        handler = logging.StreamHandler()
        handler.setFormatter(LogFormatter("%(levelname)s: %(message)s"))
        logging.basicConfig(level=level.upper(), handlers=[handler])
    return level


def _expose_metrics(ctx: typer.Context, address: str | None) -> str | None:
    if address is None or ctx.resilient_parsing:
        return address
    from comotion_schemas import metrics

    host, port = metrics.parse_address(address)
    require_closed([f"{host}:{port}"], OPEN_METRICS, insecure=bool(ctx.params.get("insecure")))
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
        # Not from the environment, which is the router's: another process would take its port.
        "--listen",
        metavar="ENDPOINT",
        help="Also act as a router, at this endpoint; may be repeated.",
    ),
]
RouterListen = Annotated[
    list[str] | None,
    typer.Option(
        "--listen",
        envvar="COMOTION_LISTEN",
        metavar="ENDPOINT",
        help="Endpoint of the router; may be repeated.",
    ),
]
Tls = Annotated[
    Path | None,
    typer.Option(
        "--tls",
        envvar="COMOTION_TLS",
        metavar="DIR/NAME",
        is_eager=True,
        help="Connect with the certificate in this folder, made by 'comotion pki issue'.",
    ),
]
Insecure = Annotated[
    bool,
    typer.Option(
        "--insecure",
        envvar="COMOTION_INSECURE",
        is_eager=True,
        help="Allow to listen where other machines can connect, without certificates.",
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
        help="Least severity of messages on standard error.",
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
        help="Serve Prometheus metrics, by default on 127.0.0.1; 0 chooses a free port.",
    ),
]
ReadyFile = Annotated[
    Path | None,
    typer.Option(
        "--ready-file",
        envvar="COMOTION_READY_FILE",
        metavar="PATH",
        help="Write this file when ready, instead of printing 'ready'.",
    ),
]
Method = Annotated[
    str | None,
    typer.Option("--method", envvar="COMOTION_METHOD", help="Method: comotion or thesis."),
]
BodyNames = Annotated[
    list[str] | None,
    typer.Option(
        "--name",
        envvar="COMOTION_NAMES",
        metavar="ID=NAME",
        help="Name of a hypothesis, such as 2=truck; may be repeated.",
    ),
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


def name_of_certificate(ctx: typer.Context, name: str | None) -> str | None:
    """Callback of ``--name``: without one, the name in the certificate."""
    source, tls = ctx.get_parameter_source("name"), ctx.params.get("tls")
    if tls is None or ctx.resilient_parsing or (source is not None and source.name != "DEFAULT"):
        return name
    from comotion_schemas.tls import load_tls

    try:
        identity = load_tls(tls).identity
    except ValueError:  # said when the session is opened
        return name
    return name if identity is None else identity.name


def host_name() -> str:
    """The name of this host, as a name of the protocol."""
    return re.sub(r"[^a-z0-9_-]+", "-", socket.gethostname().lower())[:48] or "host"


def urls(text: str | None) -> tuple[str, ...]:
    """Split urls that are separated by commas."""
    return tuple(url.strip() for url in (text or "").split(",") if url.strip())


def load_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    UserError
        If the file cannot be read or is not valid TOML.
    """
    from comotion_sources.bounded import parse_toml, read_text
    from comotion_sources.errors import InputError

    try:
        text = read_text(path, _MAX_BYTES)
    except InputError as error:
        raise UserError(one_line(error)) from None
    try:
        return parse_toml(text)
    except ValueError as error:
        raise UserError(f"{path}: {one_line(error)}") from None


def command_defaults(ctx: typer.Context, path: Path, content: dict[str, Any]) -> dict[str, Any]:
    """Return the values that a configuration file has for the command of a context.

    Raises
    ------
    UserError
        If a key is unknown: a misspelt option must not be ignored.
    """
    _check_top_level(ctx, path, content)
    known = _parameters(ctx)
    common = {
        known[name]: value for key, value in content.items() if (name := spelling(key)) in COMMON & set(known)
    }
    return common | _command_table(ctx, path, content, known)


def _parameters(ctx: typer.Context) -> dict[str, str]:
    """Map the name of an option in a file to the parameter of the command's function."""
    known = {}
    for parameter in ctx.command.params:
        for given in parameter.opts:
            if parameter.name:
                known[spelling(given.lstrip("-"))] = parameter.name
    return known


def _check_top_level(ctx: typer.Context, path: Path, content: dict[str, Any]) -> None:
    root = getattr(ctx.find_root().command, "commands", {})
    commands = root.keys() | getattr(root.get("dev"), "commands", {}).keys()
    for key, value in content.items():
        allowed = commands | FREE_TABLES if isinstance(value, dict) else COMMON
        if spelling(key) not in allowed and key not in allowed:
            what = "table" if isinstance(value, dict) else "common option"
            raise UserError(f"{path}: unknown {what} {key!r}; one of {', '.join(sorted(allowed))}")


def _command_table(
    ctx: typer.Context, path: Path, content: dict[str, Any], known: dict[str, str]
) -> dict[str, Any]:
    table: Any = content
    chunks = [one for one in ctx.command_path.split()[1:] if one != "dev"]
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
    """Return a table of the configuration file that does not belong to a command; default: empty."""
    table: dict[str, Any] = ctx.meta.get(_FILE, {}).get(name, {})
    return table


def reject_flags(ctx: typer.Context, names: tuple[str, ...], why: str) -> None:
    """Reject options on the command line that have no effect; environment and files may set them.

    Parameters
    ----------
    ctx
        Context of the command.
    names
        Parameters of its function.
    why
        End of the message, after the option.

    Raises
    ------
    UserError
        If one of the options is on the command line.
    """
    for name in names:
        source = ctx.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            flag = {"assignments": "--set"}.get(name, f"--{name.replace('_', '-')}")
            raise UserError(f"{flag} {why}")
