"""Compiles before a first call, and says so on standard error: silence would look like a fault."""

import sys
import time

# Between two lines.
_LINE_S = 3.0


def compile_ahead(method: str, unit: str = "", dim: int = 0, sources: int = 1) -> None:
    """Compile on every core what a kind of scene needs and the disk has not; without a unit, of any scene."""
    from .. import precompiling  # noqa: PLC0415 - takes a second

    begun_s = reported_s = time.monotonic()
    scene = precompiling.kinds_of_scene(method, unit, dim, sources)
    for done, total in precompiling.compile_ahead(scene if unit else precompiling.kinds_of_method(method)):
        now_s = time.monotonic()
        if not done:
            _say(f"compiling {total} kernels, once: about half a minute; the result is kept on disk")
        elif now_s - reported_s > _LINE_S or done == total:
            reported_s = now_s
            _say(f"compiling: {done} of {total} kernels in {now_s - begun_s:.0f} s")


def _say(text: str) -> None:
    print(f"comotion: {text}", file=sys.stderr, flush=True)  # noqa: T201
