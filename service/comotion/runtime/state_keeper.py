"""Writes the state of a running fusion to a file, beside the loop."""

import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from .. import snapshot
from ..fusion import Fusion
from .state_file import write_atomically, write_reserved

# Share of the time that the loop may spend on taking its state.
_SHARE = 0.05
# Ids reserved at once in the second file: it is written that rarely.
_RESERVED = 1000
_log = logging.getLogger(__name__)


class StateSchedule:
    """When to take the state: at an interval, and at once when the set of hypotheses has changed.

    A state that takes long is taken less often: it costs at most 5 % of the time.
    """

    def __init__(self, interval_ns: int) -> None:
        self._interval_ns = interval_ns
        self._due_ns = 0
        self._allowed_ns = 0
        self._known: frozenset[int] = frozenset()

    def is_due(self, monotonic_ns: int, hypotheses: frozenset[int]) -> bool:
        """Whether to take it now."""
        if monotonic_ns < self._allowed_ns:
            return False
        return monotonic_ns >= self._due_ns or hypotheses != self._known

    def taken(self, monotonic_ns: int, took_ns: int, hypotheses: frozenset[int]) -> None:
        """Note that it has been taken, and for how long that has blocked the caller."""
        self._known = hypotheses
        self._allowed_ns = monotonic_ns + round(took_ns / _SHARE)
        self._due_ns = monotonic_ns + self._interval_ns


class StateWriter:
    """Serialises and writes the newest state from a thread, so that neither delays an update."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._reserved = 0
        self._wake = threading.Condition()
        self._produce: Callable[[], list[Any]] | None = None
        self._closing = False
        self.error: str = ""
        self._thread = threading.Thread(target=self._run, name="state", daemon=True)
        self._thread.start()

    def put(self, produce: Callable[[], list[Any]]) -> None:
        """Write this state soon, as `capture` of the fusion gives it; it replaces one that waits."""
        with self._wake:
            self._produce = produce
            self._wake.notify()

    def close(self) -> None:
        """Write what still waits and end the thread."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._produce is not None or self._closing)
                produce, self._produce = self._produce, None
            if produce is None:
                return
            self._write(produce)

    def _write(self, produce: Callable[[], list[Any]]) -> None:
        try:
            parts = produce()
            self._reserve(snapshot.Header.read(parts[0]).following)
            write_atomically(self._path, parts)
            self.error = ""
        except Exception as error:  # whatever it is, the next state may be written
            reason = error.strerror if isinstance(error, OSError) else repr(error)
            if not self.error:
                _log.warning("cannot write the state to %s: %s", self._path, reason)
            self.error = f"state not written: {reason}"

    def _reserve(self, following: int) -> None:
        """Note ids as given out before the state that needs it is written."""
        if following > self._reserved:
            self._reserved = following + _RESERVED
            write_reserved(self._path, self._reserved)


class StateKeeper:
    """Keeps the state of a running fusion in a file.

    As a context manager, it writes the last state on leaving, unless an exception is the reason.

    Parameters
    ----------
    path
        The state file; None: nothing is kept.
    interval_ns
        Time between two writes.
    fusion
        Whose state it is.
    """

    def __init__(self, path: Path | None, interval_ns: int, fusion: Fusion) -> None:
        self._fusion = fusion
        self._schedule = StateSchedule(interval_ns)
        self._writer = None if path is None else StateWriter(path)

    @property
    def error(self) -> str:
        """Why the last write failed; empty if it did not."""
        return "" if self._writer is None else self._writer.error

    def after(self, hypotheses: frozenset[int], monotonic_ns: int) -> None:
        """Take the state if it is due; `hypotheses` are the ids in the update just published."""
        if self._writer is not None and self._schedule.is_due(monotonic_ns, hypotheses):
            self._writer.put(self._fusion.capture())
            self._schedule.taken(monotonic_ns, time.monotonic_ns() - monotonic_ns, hypotheses)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is None:
            return
        if kind is None:
            self._writer.put(self._fusion.capture(clean=True))
        self._writer.close()
