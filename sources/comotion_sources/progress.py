"""Progress of a replay on standard error: a bar on a terminal, else a line every 5 s."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from .player import Progress

_LINE_EVERY_S = 5.0


@contextmanager
def shown_progress(what: str, length: float) -> Iterator[Progress]:
    """Show progress on standard error; yields the function to call with the progress.

    Parameters
    ----------
    what
        Name of the recording.
    length
        Seconds of one pass.
    """
    if sys.stderr.isatty():
        with _bar(what, length) as progress:
            yield progress
    else:
        yield _lines(what, length)


@contextmanager
def _bar(what: str, length: float) -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=None),
        TextColumn("{task.completed:.1f}/{task.total:.1f} s"),
    )
    with Bar(*columns, console=Console(stderr=True), refresh_per_second=5) as bar:
        task = bar.add_task(what, total=length)

        def advance(number: int, t: float) -> None:
            bar.update(task, completed=t, description=_describe(what, number))

        yield advance


def _lines(what: str, length: float) -> Progress:
    due = time.monotonic() + _LINE_EVERY_S

    def advance(number: int, t: float) -> None:
        nonlocal due
        if time.monotonic() < due:
            return
        due = time.monotonic() + _LINE_EVERY_S
        print(f"{_describe(what, number)}: {t:.1f} of {length:.1f} s", file=sys.stderr, flush=True)  # noqa: T201 - the progress display of a command

    return advance


def _describe(what: str, number: int) -> str:
    return what if number == 0 else f"{what}, pass {number + 1}"
