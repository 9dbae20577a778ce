"""``comotion source``: the processes that observe."""

import typer

from . import source_simulator

app = typer.Typer(help="Observe: publish tracked features to a scene.", no_args_is_help=True)
app.command("simulator", epilog=source_simulator.EPILOG)(source_simulator.simulator)
