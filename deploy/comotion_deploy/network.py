"""Session settings of a command's endpoints and certificates; refuses to listen openly by accident."""

import ipaddress
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import UserError

if TYPE_CHECKING:
    from comotion_schemas.transport import SessionSettings

OPEN_ROUTER = (
    "without certificates everyone who can reach this address can read all scenes and publish as any source "
    "or service, and nothing is encrypted"
)
OPEN_METRICS = "everyone who can reach this address can read the names, rates and counters of this process"


def is_loopback(address: str) -> bool:
    """Whether ``HOST``, ``HOST:PORT`` or ``PROTOCOL/HOST:PORT`` is reachable from this machine alone."""
    protocol, slash, rest = address.rpartition("/")
    if slash and protocol.partition("/")[0] in {"unixsock-stream", "unixpipe"}:
        return True
    host = rest.rpartition(":")[0] or rest
    host = host.strip("[]").partition("%")[0]
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def require_closed(addresses: Iterable[str], meaning: str, *, insecure: bool, remedy: str = "") -> None:
    """Refuse addresses that other machines can reach, or say what they mean if `insecure`.

    Parameters
    ----------
    addresses
        Where the process is about to listen.
    meaning
        What others could do.
    insecure
        The user accepts that.
    remedy
        What to do instead.

    Raises
    ------
    UserError
        If one is open and `insecure` is not given.
    """
    for address in addresses:
        if is_loopback(address):
            continue
        if ":" not in address:
            raise UserError(f"{address!r} is not an address to listen at; one is tcp/127.0.0.1:7447")
        if not insecure:
            instead = f"{remedy}, or " if remedy else ""
            raise UserError(
                f"{address} can be reached from other machines: {meaning}. Use {instead}--insecure"
            )
        print(f"WARNING: {address}: {meaning}", file=sys.stderr, flush=True)


def session_settings(
    connect: list[str] | None,
    listen: list[str] | None = None,
    tls: Path | None = None,
    *,
    insecure: bool = False,
) -> "SessionSettings":
    """Build the session settings of the common options.

    A process that listens is a router, and connects to other routers only if `connect` is given.

    Raises
    ------
    UserError
        If it would listen where other machines can reach it.
    ValueError
        If the certificate is not valid, or does not fit the endpoints.
    """
    from comotion_schemas.transport import SessionSettings, client_settings

    if not listen:
        return client_settings(connect, tls)
    if tls is not None:
        raise UserError("--listen has no certificates: run 'comotion router --secure DIR' beside it")
    require_closed(listen, OPEN_ROUTER, insecure=insecure, remedy="'comotion router --secure DIR'")
    return SessionSettings(mode="router", connect=tuple(connect or ()), listen=tuple(listen))
