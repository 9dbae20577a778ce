"""Compiles before a first call, and says so on standard error: silence would look like a fault."""

import sys
import time
from functools import cache

# Between two lines.
_LINE_S = 3.0
# Kernels that take long enough to say how long.
_MANY = 40


@cache  # once a process
def compile_ahead(method: str, unit: str, dim: int, sources: int = 1) -> None:
    """Compile on every core what a kind of scene needs and the disk has not."""
    from .. import precompiling  # noqa: PLC0415 - takes a second

    begun_s = reported_s = time.monotonic()
    for done, total in precompiling.compile_ahead(precompiling.kinds_of_scene(method, unit, dim, sources)):
        now_s = time.monotonic()
        if not done:
            length = "about half a minute" if total > _MANY else "some seconds"
            _say(f"compiling {total} kernels, once: {length}; the result is kept on disk")
        elif now_s - reported_s > _LINE_S or done == total:
            reported_s = now_s
            _say(f"compiling: {done} of {total} kernels in {now_s - begun_s:.0f} s")


def _say(text: str) -> None:
    print(f"comotion: {text}", file=sys.stderr, flush=True)  # noqa: T201
