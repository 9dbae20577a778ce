"""Options and checks of the commands of ``comotion dev reproduce``."""

import json
import os
from collections.abc import Callable, Iterator, Sequence
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
        help="Folder that keeps tracks for the next run. Default: a folder in ~/.cache/comotion.",
    ),
]


def check(out: Path) -> None:
    """Check before hours of work what would fail at the end.

    Raises
    ------
    UserError
        If matplotlib is not installed, or `out` exists and is not a folder.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise missing_extra("plot", error) from None
    check_folder(out)


def check_folder(out: Path) -> None:
    """Check that a path can be used as a folder.

    Raises
    ------
    UserError
        If it exists and is not a folder.
    """
    if out.exists() and not out.is_dir():
        raise UserError(f"{out}: not a folder")


def known_parts(parts: Sequence[str] | None, known: Sequence[str]) -> list[str]:
    """Check the parts of an experiment; none: all are meant.

    Raises
    ------
    UserError
        If there is no part of that name.
    """
    unknown = [one for one in parts or () if one not in known]
    if unknown:
        raise UserError(f"no part {unknown[0]!r}; one of {', '.join(known)}")
    return list(parts or ())


def cache_folder() -> Path:
    """Return the default folder of caches."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "comotion"


def write_report(out: Path, name: str, text: str, values: object) -> tuple[str, str]:
    """Write the report of an experiment as Markdown and its values as JSON.

    Parameters
    ----------
    out
        Folder; made if it is missing.
    name
        Name of both files, without a suffix.
    text
        The report.
    values
        What the JSON file holds.

    Returns
    -------
    tuple of str
        The values as JSON, and a line that says where both files are.
    """
    out.mkdir(parents=True, exist_ok=True)
    page, data, written = out / f"{name}.md", out / f"{name}.json", json.dumps(values, indent=2)
    page.write_text(text, encoding="utf-8")
    data.write_text(written + "\n", encoding="utf-8")
    return written, f"written: {page}, {data}"


@contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """Yield a function that shows what runs next on standard error."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda what: console.print(what, highlight=False, markup=False, soft_wrap=True)
        return
    with console.status("") as status:
        # Brackets are not markup.
        yield lambda what: status.update(what.replace("[", r"\["))
