"""``comotion dev``: the group of commands for those who change comotion."""

import typer

from ..options import add
from . import reproduce
from .bench import Bench
from .soak import Soak
from .warm_up import WarmUp

app = typer.Typer(help="Measure, stress and reproduce; compile ahead.", no_args_is_help=True)
add(app, {"reproduce": reproduce.app, "bench": Bench, "soak": Soak, "warm-up": WarmUp})

MOVED = frozenset({"bench", "reproduce", "soak", "warm-up"})
"""Commands that had no group; their old names are accepted for one release."""
