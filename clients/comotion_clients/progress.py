"""Progress of a command on standard error: one line that changes on a terminal, else a line at times."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import TypeAlias

from rich.console import Console
from rich.live import Live

Report: TypeAlias = Callable[[Callable[[], str]], None]
"""Takes a function that builds the line; calls it only when a line is due."""


@contextlib.contextmanager
def reporting(*, quiet: bool, terminal_s: float, plain_s: float) -> Iterator[Report]:
    """Yield a function to call often; it prints when a line is due.

    Parameters
    ----------
    quiet
        Print nothing.
    terminal_s, plain_s
        Seconds between two lines on a terminal, and elsewhere.
    """
    if quiet:
        yield lambda line: None  # noqa: ARG005
    elif sys.stderr.isatty():
        with Live(console=Console(stderr=True), refresh_per_second=4, transient=True) as live:
            yield _Periodic(terminal_s, live.update)
    else:
        yield _Periodic(plain_s, lambda line: print(line, file=sys.stderr, flush=True))  # noqa: T201


class _Periodic:
    def __init__(self, period_s: float, show: Callable[[str], None]) -> None:
        self._period_s, self._show = period_s, show
        # The first line comes soon: it shows that something happens.
        self._due = time.monotonic() + min(period_s, 1.0)

    def __call__(self, line: Callable[[], str]) -> None:
        now = time.monotonic()
        if now >= self._due:
            self._due = now + self._period_s
            self._show(line())
