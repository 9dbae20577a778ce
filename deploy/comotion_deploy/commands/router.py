"""``comotion router``: the Zenoh router that all processes of a system connect to."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .. import options
from ..errors import UserError, missing_extra

if TYPE_CHECKING:
    from ..router import RouterSetup

EPILOG = """
Examples:

  comotion router   # for this machine alone

  comotion router --secure pki   # for a network: certificates, and access by what they allow

  comotion router --secure pki --tls pki/hall-2 --connect quic/hall-1:7447   # a second one

  comotion router --listen tcp/0.0.0.0:7447 --insecure   # a network that you trust

  comotion router --config router.toml   # tables zenoh.access_control, zenoh.low_pass_filter, ...

SIGHUP restarts it in place, with the certificates that the folder then has.
"""

DEFAULT_LISTEN = "tcp/127.0.0.1:7447"


def router(
    ctx: typer.Context,
    secure: Annotated[
        Path | None,
        typer.Option(
            "--secure",
            envvar="COMOTION_SECURE",
            metavar="DIR",
            help="Mutual TLS and access rules from the certificates in this folder of 'comotion pki'.",
        ),
    ] = None,
    listen: options.RouterListen = None,
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
            help="Drop larger messages at the router. Default: 32 MiB, the limit of the transport; "
            "with --secure 4 MiB for a batch.",
        ),
    ] = None,
    ready_file: options.ReadyFile = None,
    _config: options.ConfigFile = None,
    tls: Annotated[
        Path | None,
        typer.Option(
            "--tls",
            envvar="COMOTION_TLS",
            metavar="DIR/NAME",
            help="With --secure: the folder of this router. Default: the only router in DIR.",
        ),
    ] = None,
    insecure: options.Insecure = False,
    _log_level: options.Log = options.LogLevel.INFO,
) -> None:
    """Route messages between sources, the service and clients (Zenoh in router mode)."""
    from ..router import run_router

    table = options.file_table(ctx, "zenoh")
    if secure is None:
        if tls is not None:
            raise UserError("--tls is for a router with --secure DIR")
        set_up = _plain(connect, listen or [DEFAULT_LISTEN], table, max_message_bytes, insecure=insecure)
        run_router(lambda: set_up, ready_file)
        return
    if table:
        raise UserError("--secure makes the tables of [zenoh] itself")
    try:
        from ..pki.secure_router import secure_setup
    except ImportError as error:
        raise missing_extra("secure", error) from None
    run_router(
        lambda: secure_setup(
            secure, tls, connect=connect or (), listen=listen or (), max_batch_bytes=max_message_bytes
        ),
        ready_file,
    )


def _plain(
    connect: list[str] | None,
    listen: list[str],
    table: dict[str, Any],
    max_message_bytes: int | None,
    *,
    insecure: bool,
) -> "RouterSetup":
    from ..router import RouterSetup, zenoh_overrides

    overrides = zenoh_overrides(table, max_message_bytes)
    return RouterSetup(options.session_settings(connect, listen, insecure=insecure), overrides)
