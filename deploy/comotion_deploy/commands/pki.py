"""``comotion pki``: certificates of the components of a system, from a private authority in a folder."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .. import options
from ..errors import missing_extra

if TYPE_CHECKING:
    from datetime import datetime

    from ..pki.authority import Issued

EPILOG = """
Example:

  comotion pki init pki

  comotion pki issue pki --role router --name hall --host 10.0.0.1

  comotion pki issue pki --role service --name fusion

  comotion pki issue pki --role source --name klt-left

  comotion router --secure pki   # the others: --tls pki/NAME
"""
app = typer.Typer(help="Make and list the certificates of a system.", epilog=EPILOG, no_args_is_help=True)

INIT_EPILOG = """
Example:

  comotion pki init pki   # on a machine that you trust; the key pki/ca.key never leaves it
"""
ISSUE_EPILOG = """
Examples:

  comotion pki issue pki --role router --name hall --host router.local --host 10.0.0.1

  comotion pki issue pki --role service --name fusion --scene cell

  comotion pki issue pki --role source --name klt-left --scene cell

  comotion pki issue pki --role source --name rig --source rig-1 --source rig-2 --scene cell

  comotion pki issue pki --role viewer --name laptop --scene '*'

  comotion pki issue pki --role source --name klt-left --scene cell --renew

Then restart the routers (or send them SIGHUP), and run the component with --tls pki/NAME.
"""
LIST_EPILOG = """
Examples:

  comotion pki list pki   # exit status 1 if a certificate is not valid or expires within 30 days

  comotion pki list pki --json
"""
EXPORT_EPILOG = """
Examples:

  comotion pki export pki klt-left /tmp/klt-left   # its own key and certificates

  comotion pki export pki hall-2 /tmp/hall-2   # a router: also the certificates of all others, without keys
"""
Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the authority.")]


class RoleChoice(StrEnum):
    """Roles of certificates."""

    SOURCE = "source"
    SERVICE = "service"
    VIEWER = "viewer"
    RECORDER = "recorder"
    ROUTER = "router"


@app.command("init", epilog=INIT_EPILOG)
def init(
    folder: Folder,
    days: Annotated[int, typer.Option("--days", min=1, help="Validity of the authority.")] = 3650,
) -> None:
    """Make a private authority: a certificate that signs those of components."""
    made = _authority().Authority.create(folder, days)
    print(f"{folder}: authority made, valid until {made.certificate.not_valid_after_utc:%Y-%m-%d}")
    print(f"keep {folder / 'ca.key'} secret: whoever has it can be any component")


@app.command("issue", epilog=ISSUE_EPILOG)
def issue(
    folder: Folder,
    role: Annotated[RoleChoice, typer.Option("--role", help="What the component is.")],
    name: Annotated[str, typer.Option("--name", help="Its name, unique in DIR.")],
    scene: Annotated[
        str, typer.Option("--scene", envvar="COMOTION_SCENE", help="Its scene; '*' is every scene.")
    ] = "default",
    source: Annotated[
        list[str] | None,
        typer.Option("--source", help="Name of a source in this process; may be repeated. Default: NAME."),
    ] = None,
    joints: Annotated[
        list[str] | None,
        typer.Option("--joints", help="Name of joint states that a source follows; may be repeated."),
    ] = None,
    host: Annotated[
        list[str] | None,
        typer.Option("--host", help="Name or address of a router, as others connect to it; may be repeated."),
    ] = None,
    max_rate: Annotated[
        float | None,
        typer.Option("--max-rate", min=0, help="Most messages per second of a source; 0: any. Default: 250."),
    ] = None,
    days: Annotated[float, typer.Option("--days", min=0.001, help="Validity.")] = 365,
    renew: Annotated[
        bool, typer.Option("--renew", help="Replace its certificate and key; the old ones stay valid.")
    ] = False,
) -> None:
    """Issue the certificate of one component to DIR/NAME, with a private key for it alone."""
    made = _authority()
    from ..pki.grants import DEFAULT_RATE, Grant

    grant = Grant(
        role=role.value,
        name=name,
        common_name="new",
        scene="*" if role is RoleChoice.ROUTER else scene,
        sources=tuple(source or [name]) if role is RoleChoice.SOURCE else tuple(source or ()),
        joints=tuple(joints or ()),
        rate=DEFAULT_RATE if max_rate is None else max_rate,
    )
    hosts = _hosts(host) if role is RoleChoice.ROUTER else list(host or ())
    issued = made.Authority(folder).issue(grant, hosts=hosts, days=days, renew=renew)
    what = f"{role.value} {name!r}"
    print(f"{issued}: certificate of {what}; names: {', '.join(hosts or grant.sources or (name,))}")
    print(f"next: restart the routers, then run it with --tls {issued}")


@app.command("list", epilog=LIST_EPILOG)
def list_(folder: Folder, json_: options.Json = False) -> None:
    """List the components of an authority, and when their certificates expire."""
    import json
    import sys
    from datetime import UTC, datetime

    now = datetime.now(UTC)
    authority = _authority().Authority(folder)
    rows = [_row(entry, now) for entry in authority.issued()]
    expiry = authority.certificate.not_valid_after_utc
    if json_:
        print(json.dumps({"authority_expires": expiry.isoformat(), "components": rows}, indent=2))
    else:
        _print_rows(rows)
        print(f"the authority expires on {expiry:%Y-%m-%d}")
    bad = [row["name"] for row in rows if row["problem"] or row["warning"]]
    if bad:
        print(f"look at: {', '.join(bad)}", file=sys.stderr)
        raise typer.Exit(1)


@app.command("export", epilog=EXPORT_EPILOG)
def export(
    folder: Folder,
    name: Annotated[str, typer.Argument(metavar="NAME", help="The component.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder to write to.")],
) -> None:
    """Copy what the host of one component needs, without the keys of others."""
    for written in _authority().export(folder, name, out):
        print(written)


def _authority() -> Any:
    try:
        from ..pki import authority
    except ImportError as error:
        raise missing_extra("secure", error) from None
    return authority


def _hosts(given: list[str] | None) -> list[str]:
    """Names and addresses of a router: those given, and those of this machine's loopback interface."""
    import socket

    own = ["localhost", "127.0.0.1", "::1"]
    return list(dict.fromkeys([*(given or [socket.gethostname()]), *own]))


def _row(entry: "Issued", now: "datetime") -> dict[str, Any]:
    from comotion_schemas.tls import KEY_FILE, WARN_BEFORE_S

    grant, warning = entry.grant, ""
    if entry.not_after is not None and (entry.not_after - now).total_seconds() < WARN_BEFORE_S:
        warning = "expires soon"
    key = entry.folder / KEY_FILE
    if key.exists() and key.stat().st_mode & 0o077:
        warning = "others may read its key"
    return {
        "name": entry.folder.name,
        "role": "" if grant is None else grant.role,
        "scene": "" if grant is None else grant.scene,
        "sources": [] if grant is None else list(grant.sources),
        "rate": None if grant is None or grant.role != "source" else grant.rate,
        "expires": None if entry.not_after is None else entry.not_after.isoformat(),
        "days": None
        if entry.not_after is None
        else round((entry.not_after - now).total_seconds() / 86_400, 1),
        "problem": entry.problem,
        "warning": "" if entry.problem else warning,
    }


def _print_rows(rows: list[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table("name", "role", "scene", "publishes as", "expires", "days", "", box=None, pad_edge=False)
    for row in rows:
        days = "" if row["days"] is None else f"{row['days']:.0f}"
        expires = (row["expires"] or "")[:10]
        note = row["problem"] or row["warning"]
        table.add_row(row["name"], row["role"], row["scene"], " ".join(row["sources"]), expires, days, note)
    Console(width=None if _on_terminal() else 140).print(table)


def _on_terminal() -> bool:
    import sys

    return sys.stdout.isatty()
