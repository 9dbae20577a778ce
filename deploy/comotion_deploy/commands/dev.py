"""``comotion dev``: the group of commands for those who change comotion."""

import typer

from ..checkout import commands_of_checkout
from ..options import add
from . import reproduce
from .warm_up import WarmUp

app = typer.Typer(help="Measure, stress and reproduce; compile ahead.", no_args_is_help=True)
add(app, {"reproduce": reproduce.app, **commands_of_checkout("TOOLS"), "warm-up": WarmUp})

MOVED = frozenset({"bench", "reproduce", "soak", "warm-up"})
"""Commands that had no group; their old names are accepted for one release."""

OF_CHECKOUT = frozenset({"bench", "soak"}) | frozenset({"ablation", "stress", "pixels", "accuracy"})
"""Commands and studies that are in a checkout alone."""
