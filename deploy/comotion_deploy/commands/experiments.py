"""Options and checks of the commands of ``comotion dev reproduce``."""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..errors import UserError, missing_extra
from ..options import Command, Json, Tool, option


@dataclass(kw_only=True)
class Cached(Command):
    """The option of an experiment that renders or tracks what the next run needs again."""

    cache: Path | None = option(
        None,
        "Folder that keeps tracks for the next run. Default: a folder in ~/.cache/comotion.",
        env="COMOTION_CACHE",
        metavar="DIR",
    )

    def cache_folder(self, name: str) -> Path:
        """Return the folder that keeps the tracks of the experiment of this name."""
        base = os.environ.get("XDG_CACHE_HOME")
        return self.cache or (Path(base) if base else Path.home() / ".cache") / "comotion" / name


@dataclass(kw_only=True)
class Experiment(Json, Tool):
    """What all experiments have in common: how their results are printed."""

    log_level = "warning"

    def print_written(self, values: str, text: str, written: str) -> None:
        """Print the values as JSON, or the report and where it was written."""
        print(values if self.json_ else f"{text}\n{written}")

    def print_table(self, values: str, width: int, table: object, *lines: str) -> None:
        """Print the values as JSON, or a table of at least `width` columns and lines."""
        from rich.console import Console

        if self.json_:
            print(values)
            return
        console = Console(width=max(width, Console().width))
        console.print(table)
        for line in lines:
            console.print(line, markup=False, highlight=False)


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
