"""What the commands of ``comotion reproduce`` share."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from ..errors import UserError, missing_extra

Period = Annotated[float, typer.Option("--period", min=0.05, max=10, help="s between updates.")]
Cache = Annotated[
    Path | None,
    typer.Option(
        "--cache",
        metavar="DIR",
        envvar="COMOTION_CACHE",
        help="Where tracks are kept for the next run. Default: the experiment's folder in ~/.cache/comotion.",
    ),
]


def check(out: Path) -> None:
    """Find out what would fail at the end before hours of work.

    Raises
    ------
    UserError
        If matplotlib is not installed, or `out` is no folder.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise missing_extra("plot", error) from None
    check_folder(out)


def check_folder(out: Path) -> None:
    """Refuse what exists and is no folder.

    Raises
    ------
    UserError
        If it is none.
    """
    if out.exists() and not out.is_dir():
        raise UserError(f"{out}: is no folder")


def cache_folder() -> Path:
    """Where caches go unless told otherwise."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "comotion"


@contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """What is run next, on standard error: one line that changes in a terminal, else a line each."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda what: console.print(what, highlight=False, markup=False, soft_wrap=True)
        return
    with console.status("") as status:
        # Brackets are not markup.
        yield lambda what: status.update(what.replace("[", r"\["))
