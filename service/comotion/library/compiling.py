"""Compiles before a first call, and says so on standard error: silence would look like a fault."""

import sys
import time
from typing import Any

# Between two lines.
_LINE_S = 3.0


class _Progress:
    """Hears of each kernel that is compiled; of those that are read from disk it does not hear."""

    def __init__(self) -> None:
        self._begun_s = self._reported_s = 0.0
        self._kernels = self._depth = 0

    def on_start(self, now_s: float) -> None:
        """One begins, maybe within another."""
        self._depth += 1
        if self._begun_s == 0.0:
            self._begun_s = self._reported_s = now_s
            _say("compiling, once; the result is kept on disk")

    def on_end(self, now_s: float) -> None:
        """One has ended."""
        self._depth -= 1
        self._kernels += self._depth == 0
        if now_s - self._reported_s > _LINE_S:
            self._reported_s = now_s
            _say(f"compiling: {self._kernels} kernels in {now_s - self._begun_s:.0f} s")


def compile_ahead(method: str, unit: str, dim: int, sources: int = 1) -> None:
    """Compile on every core what a kind of scene needs and the disk has not; then as the next function."""
    from ..precompiling import compile_ahead as compile_  # noqa: PLC0415 - takes a second
    from ..precompiling import kinds_of_scene  # noqa: PLC0415

    begun_s = reported_s = time.monotonic()
    for done, total in compile_(kinds_of_scene(method, unit, dim, sources)):
        now_s = time.monotonic()
        if not done and reported_s == begun_s:
            _say(f"compiling {total} kernels, once: about half a minute; the result is kept on disk")
            reported_s = now_s
        elif now_s - reported_s > _LINE_S or done == total:
            reported_s = now_s
            _say(f"compiling: {done} of {total} kernels in {now_s - begun_s:.0f} s")
    report_compiling()


def report_compiling() -> None:
    """Say on standard error, from now on, when kernels are compiled."""
    from numba.core import event  # noqa: PLC0415 - takes a second, and is needed by then

    if _installed:
        return
    progress = _Progress()

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:  # noqa: ARG002
            progress.on_start(time.monotonic())

        def on_end(self, event: Any) -> None:  # noqa: ARG002
            progress.on_end(time.monotonic())

    event.register("numba:compile", Listener())  # type: ignore[no-untyped-call]
    _installed.append(progress)


_installed: list[_Progress] = []


def _say(text: str) -> None:
    print(f"comotion: {text}", file=sys.stderr, flush=True)  # noqa: T201
