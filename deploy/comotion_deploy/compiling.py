"""Shows how far a warm-up is."""

import threading
import time
from collections.abc import Iterable

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
