"""``comotion dev``: the groups of commands for those who change comotion, and for its experiments.

Most of its tools are in a checkout alone, beside the tests.
"""

import os
import sys
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import typer
from typer.core import TyperGroup

from ..errors import UserError
from ..options import Command, Tool, add, flowing, option
from .experiments import Figures

_TESTS = Path(__file__).parents[3] / "tests"


def in_checkout() -> bool:
    """Whether this is a checkout of the repository, not what a wheel installed."""
    return (_TESTS / "comotion_tools").is_dir()


def commands_of_checkout(group: Literal["TOOLS", "STUDIES"]) -> dict[str, type[Command]]:
    """Commands beside the tests, which no wheel has; processes that are started from here find them too."""
    if not in_checkout():
        return {}
    if str(_TESTS) not in sys.path:
        sys.path.append(str(_TESTS))
    paths = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    if str(_TESTS) not in paths:
        os.environ["PYTHONPATH"] = os.pathsep.join([*filter(None, paths), str(_TESTS)])
    from comotion_tools import commands

    return commands.TOOLS if group == "TOOLS" else commands.STUDIES


class WarmUp(Tool):
    """Compile all kernels: some minutes once, some seconds when it has been done.

    The result is kept on disk, in NUMBA_CACHE_DIR if that is set. 'make setup' and the container image
    have done it.
    """

    epilog = """
Examples:
  comotion dev warm-up
  NUMBA_CACHE_DIR=/var/cache/comotion comotion dev warm-up   # when an image is built
"""
    log_level = "warning"

    method: list[str] | None = option(None, "Methods to compile for: comotion, thesis. Default: both.")

    def run(self) -> None:
        """Compile for each method."""
        from comotion import FusionConfig
        from comotion.warm_up import prepare

        begun = time.monotonic()
        for name in self.method or ("comotion", "thesis"):
            try:
                config = FusionConfig.model_validate({"method": name})
            except ValueError:
                raise UserError(f"unknown method {name!r}; one of comotion, thesis") from None
            show_progress(name, prepare(config))
            print(f"{name}: compiled, {time.monotonic() - begun:.0f} s", flush=True)


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

OF_CHECKOUT = frozenset({"bench", "soak", "ablation", "stress", "pixels", "carried", "accuracy"})
"""Commands and studies that are in a checkout alone."""


_TICK_S = 0.5


def show_progress(name: str, steps: Iterable[None]) -> None:
    """Take the steps of a warm-up; a line on standard error shows how long it has taken."""
    from comotion_schemas.terminal import reporting

    begun, over = time.monotonic(), threading.Event()

    with reporting() as report:

        def tick() -> None:
            while not over.wait(_TICK_S):
                report(lambda: f"{name}: {time.monotonic() - begun:.0f} s")

        ticking = threading.Thread(target=tick, daemon=True)
        ticking.start()
        try:
            for _ in steps:
                pass
        finally:
            over.set()
            ticking.join()
