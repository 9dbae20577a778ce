"""``comotion dev``: the group of commands for those who change comotion."""

import typer

from . import bench, reproduce, soak, warm_up

app = typer.Typer(help="Measure, stress and reproduce; compile ahead.", no_args_is_help=True)
app.add_typer(reproduce.app, name="reproduce")
app.command("bench", epilog=bench.EPILOG)(bench.bench)
app.command("soak", epilog=soak.EPILOG)(soak.soak)
app.command("warm-up", epilog=warm_up.EPILOG)(warm_up.warm_up)

MOVED = frozenset({"bench", "reproduce", "soak", "warm-up"})
"""Commands that had no group; their old names are accepted for one release."""
