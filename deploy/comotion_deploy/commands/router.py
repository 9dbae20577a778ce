"""``comotion router``: the Zenoh router that all processes of a system connect to."""

from typing import Annotated

import typer

from .. import options

EPILOG = """
Examples:

  comotion router

  comotion router --listen tcp/0.0.0.0:7447 --max-message-bytes 16777216

  comotion router --config router.toml   # tables zenoh.access_control, zenoh.low_pass_filter, ...
"""

DEFAULT_LISTEN = "tcp/127.0.0.1:7447"


def router(
    ctx: typer.Context,
    listen: options.Listen = None,
    connect: Annotated[
        list[str] | None,
        typer.Option(
            "--connect",
            envvar="COMOTION_ROUTER_CONNECT",
            metavar="ENDPOINT",
            help="Another router to connect to; may be repeated.",
        ),
    ] = None,
    max_message_bytes: Annotated[
        int | None,
        typer.Option(
            "--max-message-bytes",
            envvar="COMOTION_MAX_MESSAGE_BYTES",
            min=1024,
            help="Drop larger messages at the router. Default: 32 MiB, the limit of the transport.",
        ),
    ] = None,
    ready_file: options.ReadyFile = None,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.INFO,
) -> None:
    """Route messages between sources, the service and clients (Zenoh in router mode)."""
    from ..router import run_router, zenoh_overrides

    overrides = zenoh_overrides(options.file_table(ctx, "zenoh"), max_message_bytes)
    settings = options.session_settings(connect, listen or [DEFAULT_LISTEN])
    run_router(settings, overrides, ready_file)
