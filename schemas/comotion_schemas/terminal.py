"""A command and its terminal: its progress on standard error, and the keys that a person presses."""

import contextlib
import os
import select
import sys
import time
from collections.abc import Callable, Iterator
from typing import TypeAlias

from rich.console import Console
from rich.live import Live
from rich.text import Text

Report: TypeAlias = Callable[[Callable[[], str]], None]
"""Takes a function that builds the line; calls it only when a line is due."""


@contextlib.contextmanager
def reporting(*, quiet: bool = False, terminal_s: float = 0.25, plain_s: float = 3.0) -> Iterator[Report]:
    """Yield a function to call often: on a terminal one line changes, elsewhere a line is printed at times.

    `quiet` prints nothing; `terminal_s` and `plain_s` are the seconds between two lines on a terminal, and
    elsewhere.
    """
    if quiet:
        yield lambda line: None  # noqa: ARG005
    elif sys.stderr.isatty():
        with Live(console=Console(stderr=True), refresh_per_second=4, transient=True) as live:
            yield _periodic(terminal_s, lambda line: live.update(Text(line)))
    else:
        yield _periodic(plain_s, lambda line: print(line, file=sys.stderr, flush=True))  # noqa: T201


def _periodic(period_s: float, show: Callable[[str], None]) -> Report:
    # The first line comes soon: it shows that something happens.
    due = time.monotonic() + min(period_s, 1.0)

    def report(line: Callable[[], str]) -> None:
        nonlocal due
        now = time.monotonic()
        if now >= due:
            due = now + period_s
            show(line())

    return report


@contextlib.contextmanager
def keyboard() -> Iterator[Callable[[float], str]]:
    """Yield a function that waits up to a number of seconds for a key press; it returns the key or "".

    Without a terminal there are no keys; the function then waits.
    """
    if not sys.stdin.isatty():
        yield _no_key
        return
    import termios  # noqa: PLC0415 - where there are no terminals of this kind, there is no key
    import tty  # noqa: PLC0415

    descriptor = sys.stdin.fileno()
    attributes = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)

    def read_key(timeout: float) -> str:
        ready, _, _ = select.select([descriptor], [], [], timeout)
        return os.read(descriptor, 1).decode(errors="replace") if ready else ""

    try:
        yield read_key
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, attributes)


def _no_key(timeout: float) -> str:
    time.sleep(timeout)
    return ""
