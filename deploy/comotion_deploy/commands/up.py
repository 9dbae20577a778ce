"""``comotion up FILE.toml``: starts a system of processes."""

from pathlib import Path
from typing import Annotated

import typer

from .. import options

EPILOG = """
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

DEFAULT_LOG = Path("comotion-up.log")


def up(
    file: Annotated[Path, typer.Argument(metavar="FILE.toml", help="Description of the system.")],
    log: Annotated[
        Path | None,
        typer.Option(
            "--log",
            envvar="COMOTION_LOG",
            metavar="PATH",
            help="Write the processes' lines there. Default: standard output, or "
            f"{DEFAULT_LOG} with a foreground process.",
        ),
    ] = None,
    duration: Annotated[
        float | None, typer.Option("--duration", min=0.1, help="Stop after this many seconds.")
    ] = None,
    _log_level: options.Log = options.LogLevel.INFO,
) -> None:
    """Start router, sources, service and clients; restart failed processes; stop all on Ctrl-C."""
    from dataclasses import replace

    from ..launcher import launch
    from ..processes import read_processes

    specs = read_processes(options.load_toml(file))
    specs = [replace(spec, env={"COMOTION_CONFIG": str(file), **spec.env}) for spec in specs]
    if log is None and any(spec.foreground for spec in specs):
        log = DEFAULT_LOG
    launch(specs, log=log, duration_s=duration)
