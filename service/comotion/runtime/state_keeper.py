"""Writes the state of a running fusion to a file, beside the loop."""

import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from ..fusion import Fusion
from .state_file import write_state

# Share of the time for taking and writing states: the thread keeps the loop from the interpreter meanwhile.
_SHARE = 0.1
_log = logging.getLogger(__name__)


class StateKeeper:
    """Keeps the state of a running fusion in a file; a context manager.

    The state is taken at an interval, and at once when the set of hypotheses has changed; one that takes long
    less often, so that it costs at most a tenth of the time. A thread serialises and writes the newest one.
    On leaving the last state is written, unless an exception is the reason. Without a path nothing is kept.
    `error` is why the last write failed; empty if it did not.
    """

    def __init__(self, path: Path | None, interval_ns: int, fusion: Fusion) -> None:
        self._path = path
        self._interval_ns = interval_ns
        self._fusion = fusion
        self.error = ""
        self._due_ns = self._allowed_ns = self._writing_ns = 0
        self._saved: frozenset[int] = frozenset()
        self._reserved = 0
        self._wake = threading.Condition()
        self._produce: Callable[[], list[Any]] | None = None
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="state", daemon=True)

    def __enter__(self) -> Self:
        if self._path is not None:
            self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *others: object) -> None:
        if self._path is None:
            return
        with self._wake:
            self._produce = self._fusion.capture(clean=True) if kind is None else self._produce
            self._closing = True
            self._wake.notify()
        self._thread.join()

    def after(self, hypotheses: frozenset[int], monotonic_ns: int) -> None:
        """Take the state if it is due; `hypotheses` are the ids in the update just published."""
        if self._path is None or not self.is_due(hypotheses, monotonic_ns):
            return
        # It replaces one that waits.
        with self._wake:
            self._produce = self._fusion.capture()
            self._wake.notify()
        self._saved = hypotheses
        cost_ns = time.monotonic_ns() - monotonic_ns + self._writing_ns
        self._allowed_ns = monotonic_ns + round(cost_ns / _SHARE)
        self._due_ns = monotonic_ns + self._interval_ns

    def is_due(self, hypotheses: frozenset[int], monotonic_ns: int) -> bool:
        """Whether to take the state now."""
        if monotonic_ns < self._allowed_ns:
            return False
        return monotonic_ns >= self._due_ns or hypotheses != self._saved

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._produce is not None or self._closing)
                produce, self._produce = self._produce, None
            if produce is None:
                return
            self._write(produce)

    def _write(self, produce: Callable[[], list[Any]]) -> None:
        assert self._path is not None  # noqa: S101 - the thread runs where there is one
        began = time.thread_time_ns()
        try:
            self._reserved = write_state(self._path, produce(), self._reserved)
            self.error = ""
        except Exception as error:  # whatever it is, the next state may be written
            reason = error.strerror if isinstance(error, OSError) else repr(error)
            if not self.error:
                _log.warning("cannot write the state to %s: %s", self._path, reason)
            self.error = f"state not written: {reason}"
        self._writing_ns = time.thread_time_ns() - began
