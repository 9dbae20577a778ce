"""``comotion dev``: the groups of commands for those who change comotion, and for its experiments."""

from typing import Any

import typer
from typer.core import TyperGroup

from ..checkout import commands_of_checkout
from ..options import add, flowing
from .experiments import Figures
from .warm_up import WarmUp

_EPILOG = """
Examples:
  comotion dev reproduce --quick
  comotion dev reproduce figures --help
  comotion dev reproduce stress --quick
"""


class _FiguresByDefault(TyperGroup):
    """Uses ``figures`` if no command is given."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if not args or (args[0].startswith("-") and args[0] not in ctx.help_option_names):
            args = ["figures", *args]
        return super().parse_args(ctx, args)


_reproduce = typer.Typer(
    cls=_FiguresByDefault,
    help="Run the project's experiments again. Without a command: the figures of the thesis.",
    epilog=flowing(_EPILOG),
)
add(_reproduce, {"figures": Figures, **commands_of_checkout("STUDIES")})

app = typer.Typer(help="Measure, stress and reproduce; compile ahead.", no_args_is_help=True)
add(app, {"reproduce": _reproduce, **commands_of_checkout("TOOLS"), "warm-up": WarmUp})

MOVED = frozenset({"bench", "reproduce", "soak", "warm-up"})
"""Commands that had no group; their old names are accepted for one release."""

OF_CHECKOUT = frozenset({"bench", "soak"}) | frozenset({"ablation", "stress", "pixels", "accuracy"})
"""Commands and studies that are in a checkout alone."""
