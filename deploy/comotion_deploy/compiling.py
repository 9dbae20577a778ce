"""Shows how far a warm-up is."""

import threading
import time
from collections.abc import Iterable

_TICK_S = 0.5


def show_progress(name: str, steps: Iterable[None]) -> None:
    """Take the steps of a warm-up; a line on standard error shows how far it is, in long steps too."""
    from comotion.warm_up import STEPS
    from comotion_schemas.terminal import reporting

    begun, number, over = time.monotonic(), 1, threading.Event()

    def line() -> str:
        return f"{name}: step {number} of at most {STEPS}, {time.monotonic() - begun:.0f} s"

    with reporting() as report:

        def tick() -> None:
            while not over.wait(_TICK_S):
                report(line)

        ticking = threading.Thread(target=tick, daemon=True)
        ticking.start()
        try:
            for _ in steps:
                number += 1
        finally:
            over.set()
            ticking.join()
