"""``comotion up`` and ``comotion demo``: a system of processes in one command; ``comotion router`` of it."""

import os
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

from ..config_file import file_table, load_toml
from ..errors import UserError
from ..network import Ready, session_settings
from ..options import Fusion, Logged, Tool, argument, option, setting

DEFAULT_LOG = Path("comotion-up.log")


class Up(Logged):
    """Start router, sources, service and clients; restart failed processes; stop all on Ctrl-C."""

    epilog = """
Examples:
  comotion up deploy/scenes/fig4_4.toml
  comotion up workcell.toml --log workcell.log

The file is the --config of every process it starts; its tables process.NAME describe the processes:
  run = 'source simulator fig4.4 --rate 30'   (a comotion command)
  command = 'python my_tracker.py'   (any program)
  restart = 'on-failure'   (default; or 'always', 'never')
  tls = 'pki/cam'   (its certificate, see 'comotion pki')
  foreground = true   (owns the terminal; everything stops when it ends)
"""

    file: Path = argument(..., "FILE.toml", "Description of the system.")
    log: Path | None = setting(
        None,
        f"Write the processes' lines there. Default: standard output, or {DEFAULT_LOG} with a foreground "
        "process.",
        metavar="PATH",
    )
    duration: float | None = option(None, "Stop after this time.", min=0.1, metavar="SECONDS")

    def run(self) -> None:
        """Run the processes until they or the user end them."""
        from ..launcher import launch
        from ..processes import read_processes

        specs = read_processes(load_toml(self.file))
        specs = [replace(spec, env={"COMOTION_CONFIG": str(self.file), **spec.env}) for spec in specs]
        log = self.log
        if log is None and any(spec.foreground for spec in specs):
            log = DEFAULT_LOG
        launch(specs, log=log, duration_s=self.duration)


_THESIS_FIG_4_4 = ("thesis.sigma_switch=0.01", "thesis.v_move=null")
"""Parameters of figure 4.4 in the thesis: σ_switch 0.01 and equal weights."""


class Demo(Fusion, Logged):
    """Run router, three simulated sources, the service and watch; end with a summary and a plot."""

    epilog = """
Examples:
  comotion demo
  comotion demo --duration 60 --out /tmp/demo
  comotion demo fig4_4 --method thesis
  comotion demo 3d_outliers
"""

    simulated: str = argument(
        "3d_async", "SCENE", "A scene of the simulator; see 'comotion source simulator --list'."
    )
    duration: float = option(30.0, "How long it runs.", min=1, metavar="SECONDS")
    out: Path = option(Path("out"), "Where results and log go.", metavar="DIR", file_okay=False)
    seed: int = option(0, "Seed of the simulator.", min=0)

    def run(self) -> None:
        """Run the demo."""
        from .. import demo
        from ..launcher import launch
        from .dev import show_progress

        out, scale = self.out, demo.time_scale(self.simulated, self.duration)
        if ignored := [name for name in demo.OF_OTHER_SCENES if os.environ.pop(name, None)]:
            print(f"the demo has a router of its own and does not use {', '.join(ignored)}", flush=True)
        out.mkdir(parents=True, exist_ok=True)
        for name in ("demo.state", "summary.txt", "demo.png", "demo.json"):
            (out / name).unlink(missing_ok=True)
        print(
            f"{self.simulated} for {self.duration:g} s; Ctrl-C ends it earlier; results go to {out}",
            flush=True,
        )
        print("preparing; the first time on a machine this compiles for half a minute or more", flush=True)
        from comotion import warm_up

        show_progress("preparing", warm_up.compile_ahead(self.method or "comotion", list(warm_up.SCENES)))
        on_terminal = sys.stdout.isatty()
        as_in_thesis = self.method == "thesis" and self.simulated == "fig4_4"
        settings = self.set_ or (_THESIS_FIG_4_4 if as_in_thesis else ())
        words = [word for setting in settings for word in ("--set", setting)]
        words += ["--method", self.method] if self.method else []
        processes = demo.demo_processes(
            self.simulated,
            demo.free_endpoint(),
            out,
            fusion=words,
            scale=scale,
            seed=self.seed,
            on_terminal=on_terminal,
        )
        launch(processes, log=out / "demo.log" if on_terminal else None, duration_s=self.duration)
        summary = out / demo.SUMMARY
        scored = summary.exists()
        print(
            summary.read_text(encoding="utf-8") if scored else "stopped before anything could be scored\n",
            end="",
        )


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
            if table:
                raise UserError("--secure makes the tables of [zenoh] itself")
            from ..pki.access import secure_setup

            trusted = partial(secure_setup, self.secure, self.tls, max_batch_bytes=self.max_message_bytes)
            set_up = partial(trusted, connect=self.connect or (), listen=self.listen or ())
            run_router(set_up, self.ready_file)
            return
        if self.tls is not None:
            raise UserError("--tls is for a router with --secure DIR")
        overrides = zenoh_overrides(table, self.max_message_bytes)
        listen = self.listen or [DEFAULT_LISTEN]
        setup = RouterSetup(session_settings(self.connect, listen, insecure=self.insecure), overrides)
        run_router(lambda: setup, self.ready_file)
