"""``comotion dev reproduce``: runs the experiments of the project."""

from typing import Any

import typer
from typer.core import TyperGroup

from ..checkout import commands_of_checkout
from ..options import add, flowing
from .reproduce_figures import Figures

EPILOG = """
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


app = typer.Typer(
    cls=_FiguresByDefault,
    help="Run the project's experiments again. Without a command: the figures of the thesis.",
    epilog=flowing(EPILOG),
)
add(app, {"figures": Figures, **commands_of_checkout("STUDIES")})
