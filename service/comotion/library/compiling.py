"""Says on standard error that the first call compiles: half a minute of silence looks like a fault."""

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
            _say("compiling, once: about half a minute; the result is kept on disk")

    def on_end(self, now_s: float) -> None:
        """One has ended."""
        self._depth -= 1
        self._kernels += self._depth == 0
        if now_s - self._reported_s > _LINE_S:
            self._reported_s = now_s
            _say(f"compiling: {self._kernels} kernels in {now_s - self._begun_s:.0f} s")


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
