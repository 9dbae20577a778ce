"""``comotion router``: the Zenoh router that all processes of a system connect to."""

from pathlib import Path

from ..config_file import file_table
from ..errors import UserError
from ..network import Ready, session_settings
from ..options import Tool, setting

DEFAULT_LISTEN = "tcp/127.0.0.1:7447"


class Router(Ready, Tool):
    """Route messages between sources, the service and clients (Zenoh in router mode)."""

    epilog = """
Examples:
  comotion router   # for this machine alone
  comotion router --secure pki   # for a network: certificates, and access by what they allow
  comotion router --secure pki --tls pki/hall-2 --connect quic/hall-1:7447   # a second one
  comotion router --listen tcp/0.0.0.0:7447 --insecure   # a network that you trust
  comotion router --config router.toml   # tables zenoh.access_control, zenoh.low_pass_filter, ...

SIGHUP restarts it in place, with the certificates that the folder then has.
"""

    secure: Path | None = setting(
        None,
        "Mutual TLS and access rules from the certificates in this folder of 'comotion pki'.",
        metavar="DIR",
    )
    listen: list[str] | None = setting(None, "Endpoint of the router; may be repeated.", metavar="ENDPOINT")
    connect: list[str] | None = setting(
        None,
        "Another router to connect to; may be repeated.",
        env="COMOTION_ROUTER_CONNECT",
        metavar="ENDPOINT",
    )
    max_message_bytes: int | None = setting(
        None,
        "Drop larger messages at the router. Default: 32 MiB, the limit of the transport; "
        "with --secure 4 MiB for a batch.",
        min=1024,
    )
    tls: Path | None = setting(
        None, "With --secure: the folder of this router. Default: the only router in DIR.", metavar="DIR/NAME"
    )
    insecure: bool = setting(False, "Allow to listen where other machines can connect, without certificates.")

    def run(self) -> None:
        """Route until stopped."""
        from ..router import RouterSetup, run_router, zenoh_overrides

        table = file_table(self.ctx, "zenoh")
        if self.secure is not None:
            self._run_secure(self.secure, bool(table))
            return
        if self.tls is not None:
            raise UserError("--tls is for a router with --secure DIR")
        overrides = zenoh_overrides(table, self.max_message_bytes)
        listen = self.listen or [DEFAULT_LISTEN]
        setup = RouterSetup(session_settings(self.connect, listen, insecure=self.insecure), overrides)
        run_router(lambda: setup, self.ready_file)

    def _run_secure(self, folder: Path, has_table: bool) -> None:
        from ..router import run_router

        if has_table:
            raise UserError("--secure makes the tables of [zenoh] itself")
        from ..pki.access import secure_setup

        run_router(
            lambda: secure_setup(
                folder,
                self.tls,
                connect=self.connect or (),
                listen=self.listen or (),
                max_batch_bytes=self.max_message_bytes,
            ),
            self.ready_file,
        )
