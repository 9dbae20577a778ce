"""Compiles before a first call, and reports it on standard error: silence would look like a fault."""

import sys
import time
from functools import cache

from .. import warm_up

# Between two lines.
_LINE_S = 3.0


@cache  # once a process
def compile_ahead(method: str, unit: str, dim: int) -> None:
    """Compile the kernels of a kind of scene that are not on disk."""
    began_s, printed_s = time.monotonic(), None
    kinds = [kind for kind in warm_up.SCENES if kind == (unit, dim)]
    for _ in warm_up.compile_ahead(method, kinds or [("m", 3)]):
        now_s = time.monotonic()
        if printed_s is None:
            _say("compiling, once: about half a minute; the result is kept on disk")
        elif now_s - printed_s > _LINE_S:
            _say(f"compiling for {now_s - began_s:.0f} s")
        else:
            continue
        printed_s = now_s


def _say(text: str) -> None:
    print(f"comotion: {text}", file=sys.stderr, flush=True)  # noqa: T201
