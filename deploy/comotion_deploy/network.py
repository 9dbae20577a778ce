"""What connects: options, endpoints and certificates of a session; refuses to listen openly by accident."""

import ipaddress
import re
import socket
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import UserError
from .options import Command, Logged, Tool, option, setting

if TYPE_CHECKING:
    from comotion_schemas.component import Where
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

    The process is about to listen at `addresses`; `meaning` says what others could do, `insecure` that the
    user accepts it, `remedy` what to do instead.

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


class Ready(Command):
    """The option of a command that says when it is ready."""

    ready_file: Path | None = setting(
        None, "Write this file when ready, instead of printing 'ready'.", metavar="PATH"
    )


class Session(Logged):
    """Options of a command that connects to a router."""

    connect: list[str] | None = setting(
        None, "Router to connect to; may be repeated. Default: tcp/127.0.0.1:7447.", metavar="ENDPOINT"
    )
    tls: Path | None = setting(
        None, "Connect with the certificate in this folder, made by 'comotion pki issue'.", metavar="DIR/NAME"
    )

    def settings(self) -> "SessionSettings":
        """Return the settings of its session."""
        return session_settings(self.connect, tls=self.tls)


class Client(Session, Tool):
    """Options of a command that looks at a scene."""

    scene: str = setting("default", "Scene: one service and its sources.")


class Present(Ready, Client):
    """Options of a command that is seen in the scene while it runs."""

    def where(self) -> "Where":
        """Return where its component runs, and how it says that it is ready."""
        return {"scene": self.scene, "settings": self.settings(), "ready_file": self.ready_file}


class Process(Present):
    """Options of a process that is part of a scene."""

    name: str | None = setting(
        None, "Name of the source. With a certificate: its name.", env="COMOTION_SOURCE_NAME"
    )
    # Not from the environment, which is the router's: another process would take its port.
    listen: list[str] | None = option(
        None, "Also act as a router, at this endpoint; may be repeated.", metavar="ENDPOINT"
    )
    insecure: bool = setting(False, "Allow to listen where other machines can connect, without certificates.")
    metrics_port: str | None = setting(
        None,
        "Serve Prometheus metrics, by default on 127.0.0.1; 0 chooses a free port.",
        metavar="[HOST:]PORT",
    )

    def prepare(self) -> None:
        """Start logging, take the name in the certificate, and serve metrics."""
        super().prepare()
        given = self.ctx.get_parameter_source("name")
        if self.tls is not None and (given is None or given.name == "DEFAULT"):
            from comotion_schemas.tls import load_tls

            with suppress(ValueError):  # reported when the session is opened
                identity = load_tls(self.tls).identity
                self.name = self.name if identity is None else identity.name
        if self.metrics_port is not None:
            from comotion_schemas import metrics

            host, port = metrics.parse_address(self.metrics_port)
            require_closed([f"{host}:{port}"], OPEN_METRICS, insecure=self.insecure)
            port = metrics.expose(host, port)
            print(f"metrics at http://{host}:{port}/metrics", file=sys.stderr, flush=True)

    def settings(self) -> "SessionSettings":
        """Return the settings of its session."""
        return session_settings(self.connect, self.listen, self.tls, insecure=self.insecure)


def host_name() -> str:
    """The name of this host, as a name of the protocol."""
    return re.sub(r"[^a-z0-9_-]+", "-", socket.gethostname().lower())[:48] or "host"


def urls(text: str | None) -> tuple[str, ...]:
    """Split urls that are separated by commas."""
    return tuple(url.strip() for url in (text or "").split(",") if url.strip())
