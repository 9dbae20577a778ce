"""Shows on a terminal how far a warm-up is."""

import sys
from collections.abc import Iterable


def show_progress(name: str, steps: Iterable[None]) -> None:
    """Take the steps of a warm-up; on a terminal, one line shows how far it is."""
    from comotion.runtime.warm_up import STEPS

    shown = sys.stderr.isatty()
    for number, _ in enumerate(steps, 1):
        if shown:
            print(f"\r{name}: step {number} of at most {STEPS}", end="", file=sys.stderr, flush=True)
    if shown:
        print("\r\x1b[K", end="", file=sys.stderr, flush=True)
