"""Options and checks of the commands of ``comotion dev reproduce``."""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..errors import UserError
from ..options import Json, Tool

Pictures = Mapping[str, Callable[[Path], object]]


@dataclass(kw_only=True)
class Experiment(Json, Tool):
    """What all experiments have in common: a folder for their results, and how these are printed."""

    log_level = "warning"
    out: Path

    def report(
        self, name: str, text: str, values: object, *shown: object, pictures: Pictures | None = None
    ) -> None:
        """Write the page of an experiment, its values and its pictures, and show it.

        Parameters
        ----------
        name
            Name of page and values, without a suffix.
        text
            The page, in Markdown.
        values
            What the JSON file holds.
        shown
            Tables and lines for the terminal; the page itself by default.
        pictures
            What draws each picture, by its path in the folder.
        """
        drawn = pictures or {}
        page, numbers, *images = (self.out / file for file in (f"{name}.md", f"{name}.json", *drawn))
        for path in (page, *images):
            path.parent.mkdir(parents=True, exist_ok=True)
        page.write_text(text, encoding="utf-8")
        write_values(numbers, values)
        for path, draw in zip(images, drawn.values(), strict=True):
            draw(path)
        written = ", ".join(map(str, (page, numbers, *images)))
        self.show(values, *(shown or (text,)), f"written: {written}", width=170)


def write_values(path: Path, values: object) -> None:
    """Write results to a JSON file."""
    from comotion_schemas.plain import plain

    path.write_text(json.dumps(plain(values), indent=2) + "\n", encoding="utf-8")


def check(out: Path) -> None:
    """Check before hours of work what would fail at the end.

    Raises
    ------
    ImportError
        If matplotlib is not installed.
    UserError
        If `out` exists and is not a folder.
    """
    import matplotlib  # noqa: F401

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
