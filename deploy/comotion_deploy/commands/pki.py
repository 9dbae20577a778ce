"""``comotion pki``: certificates of the components of a system, from a private authority in a folder."""

import socket
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from ..options import Command, Json, add, argument, flowing, option, setting

if TYPE_CHECKING:
    from ..pki.authority import Issued

EPILOG = """
Example:
  comotion pki init pki
  comotion pki issue pki --role router --name hall --host 10.0.0.1
  comotion pki issue pki --role service --name fusion
  comotion pki issue pki --role source --name klt-left
  comotion router --secure pki   # the others: --tls pki/NAME
"""


class Folder(Command):
    """The folder that each of these commands works on."""

    folder: Path = argument(..., "DIR", "Folder of the authority.")


class Init(Folder):
    """Make a private authority: a certificate that signs those of components."""

    epilog = """
Example:
  comotion pki init pki   # on a machine that you trust; the key pki/ca.key never leaves it
"""

    days: int = option(3650, "Validity of the authority.", min=1)

    def run(self) -> None:
        """Make it."""
        from ..pki.authority import Authority

        made = Authority.create(self.folder, self.days)
        print(f"{self.folder}: authority made, valid until {made.certificate.not_valid_after_utc:%Y-%m-%d}")
        print(f"keep {self.folder / 'ca.key'} secret: whoever has it can be any component")


class Issue(Folder):
    """Issue the certificate of one component to DIR/NAME, with a private key for it alone."""

    epilog = """
Examples:
  comotion pki issue pki --role router --name hall --host router.local --host 10.0.0.1
  comotion pki issue pki --role service --name fusion --scene cell
  comotion pki issue pki --role source --name klt-left --scene cell
  comotion pki issue pki --role source --name rig --source rig-1 --source rig-2 --scene cell
  comotion pki issue pki --role viewer --name laptop --scene '*'
  comotion pki issue pki --role source --name klt-left --scene cell --renew

Then restart the routers (or send them SIGHUP), and run the component with --tls pki/NAME.
"""

    role: Literal["source", "service", "viewer", "recorder", "router"] = option(..., "What the component is.")
    name: str = option(..., "Its name, unique in DIR.")
    scene: str = setting("default", "Its scene; '*' is every scene.")
    source: list[str] | None = option(
        None, "Name of a source in this process; may be repeated. Default: NAME."
    )
    joints: list[str] | None = option(None, "Name of joint states that a source follows; may be repeated.")
    host: list[str] | None = option(
        None, "Name or address of a router, as others connect to it; may be repeated."
    )
    max_rate: float | None = option(
        None, "Most messages per second of a source; 0: any. Default: 250.", min=0
    )
    days: float = option(365, "Validity.", min=0.001)
    renew: bool = option(False, "Replace its certificate and key; the old ones stay valid.")

    def run(self) -> None:
        """Issue it."""
        from ..pki.authority import Authority
        from ..pki.certificates import DEFAULT_RATE, Grant

        is_router = self.role == "router"
        grant = Grant(
            role=self.role,
            name=self.name,
            common_name="new",
            scene="*" if is_router else self.scene,
            sources=tuple(self.source or ([self.name] if self.role == "source" else ())),
            joints=tuple(self.joints or ()),
            rate=DEFAULT_RATE if self.max_rate is None else self.max_rate,
        )
        hosts = self.host or []
        if is_router:  # its loopback interface too
            own = ["localhost", "127.0.0.1", "::1"]
            hosts = list(dict.fromkeys([*(hosts or [socket.gethostname()]), *own]))
        issued = Authority(self.folder).issue(grant, hosts=hosts, days=self.days, renew=self.renew)
        names = ", ".join(hosts or grant.sources or (self.name,))
        print(f"{issued}: certificate of {self.role} {self.name!r}; names: {names}")
        print(f"next: restart the routers, then run it with --tls {issued}")


class Listing(Json, Folder):
    """List the components of an authority, and when their certificates expire."""

    epilog = """
Examples:
  comotion pki list pki   # exit status 1 if a certificate is not valid or expires within 30 days
  comotion pki list pki --json
"""

    def run(self) -> None:
        """List them; exit status 1 if one needs attention."""
        from rich.table import Table

        from ..pki.authority import Authority

        now = datetime.now(UTC)
        authority = Authority(self.folder)
        rows = [_row(entry, now) for entry in authority.issued()]
        expiry = authority.certificate.not_valid_after_utc
        values = {"authority_expires": expiry.isoformat(), "components": rows}
        table = Table(
            "name", "role", "scene", "publishes as", "expires", "days", "", box=None, pad_edge=False
        )
        for row in rows:
            days = "" if row["days"] is None else f"{row['days']:.0f}"
            held = row["name"], row["role"], row["scene"], " ".join(row["sources"])
            table.add_row(*held, (row["expires"] or "")[:10], days, row["problem"] or row["warning"])
        self.show(values, table, f"the authority expires on {expiry:%Y-%m-%d}", width=140)
        bad = [row["name"] for row in rows if row["problem"] or row["warning"]]
        if bad:
            print(f"look at: {', '.join(bad)}", file=sys.stderr)
            raise typer.Exit(1)


class Export(Folder):
    """Copy what the host of one component needs, without the keys of others."""

    epilog = """
Examples:
  comotion pki export pki klt-left /tmp/klt-left   # its own key and certificates
  comotion pki export pki hall-2 /tmp/hall-2   # a router: also the certificates of all others, without keys
"""

    name: str = argument(..., "NAME", "The component.")
    out: Path = argument(..., "OUT", "Folder to write to.")

    def run(self) -> None:
        """Copy it."""
        from ..pki.authority import export

        for written in export(self.folder, self.name, self.out):
            print(written)


app = typer.Typer(
    help="Make and list the certificates of a system.", epilog=flowing(EPILOG), no_args_is_help=True
)
add(app, {"init": Init, "issue": Issue, "list": Listing, "export": Export})


def _row(entry: "Issued", now: "datetime") -> dict[str, Any]:
    from comotion_schemas.tls import KEY_FILE, WARN_BEFORE_S

    grant, key, warning = entry.grant, entry.folder / KEY_FILE, ""
    left_s = None if entry.not_after is None else (entry.not_after - now).total_seconds()
    if left_s is not None and left_s < WARN_BEFORE_S:
        warning = "expires soon"
    if key.exists() and key.stat().st_mode & 0o077:
        warning = "others may read its key"
    return {
        "name": entry.folder.name,
        "role": grant.role if grant else "",
        "scene": grant.scene if grant else "",
        "sources": list(grant.sources) if grant else [],
        "rate": grant.rate if grant and grant.role == "source" else None,
        "expires": None if entry.not_after is None else entry.not_after.isoformat(),
        "days": None if left_s is None else round(left_s / 86_400, 1),
        "problem": entry.problem,
        "warning": "" if entry.problem else warning,
    }
