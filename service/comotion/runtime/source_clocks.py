"""Measures how far the clocks of sources are ahead of the service's; corrects batches if wanted.

Each source sends a Status a second, stamped by its host's clock. With the round trip of a query to the cache
of that publisher, it tells the difference of the clocks within half of the round trip. Stamps of observations
are not used: they are those of acquisition, and how long acquisition takes is unknown.
"""

import logging
import threading
import time
from collections import deque
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Self

import zenoh

from comotion_schemas import ObservationBatch, Status
from comotion_schemas.clock_bounds import ClockBounds
from comotion_schemas.component import Component

_ASK_S = 2.0  # between two rounds of queries
_ANSWER_S = 1.0  # a source that is slower is queried again with the next round
_FORGET_S = 60.0  # after the last token or Status of a source
# A step is worth a note for so long.
_NOTED_S = 60.0
_NOTES = 8
_MOST_SOURCES = 1024
# Corrections smaller than this, or than the error of the estimate, are not worth a jump in the stamps.
_LEAST_CORRECTION_S = 0.001
_log = logging.getLogger(__name__)


@dataclass
class _Source:
    bounds: ClockBounds = field(default_factory=ClockBounds)
    seen_s: float = 0.0
    applied_ns: int = 0


class SourceClocks:
    """Follows the clocks of the sources of a scene; a context manager.

    `steps` counts how often one was set while it was followed.

    Parameters
    ----------
    component
        The open component.
    correct
        Whether :meth:`correct` shifts the stamps of batches to the service's clock.
    """

    def __init__(self, component: Component, *, correct: bool) -> None:
        self.steps = 0
        self._session = component.session
        self._keys = component.keys
        self._correct = correct
        self._lock = threading.Lock()
        self._sources: dict[str, _Source] = {}
        self._notes: deque[tuple[float, str]] = deque(maxlen=_NOTES)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._ask, name="clocks", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing.set()
        self._thread.join(2 * _ANSWER_S)

    def offsets(self) -> dict[str, float]:
        """How far each source's clock is ahead of this one's, in s; without those that are unknown."""
        with self._lock:
            found = {name: source.bounds.estimate() for name, source in self._sources.items()}
        return {name: offset[0] for name, offset in sorted(found.items()) if offset is not None}

    def notes(self) -> list[str]:
        """Steps of the last minute, in words."""
        now = time.monotonic()
        with self._lock:
            return [text for at, text in self._notes if now - at < _NOTED_S]

    def correct(self, batch: ObservationBatch) -> ObservationBatch:
        """Return a batch with its stamps by this clock, if that is wanted and the difference is known."""
        if not self._correct:
            return batch
        with self._lock:
            source = self._sources.get(batch.source)
            shift_ns = 0 if source is None else _shift(source)
        if not shift_ns:
            return batch
        stamps = None if batch.stamps_ns is None else batch.stamps_ns - shift_ns
        return replace(batch, stamp_ns=batch.stamp_ns - shift_ns, stamps_ns=stamps)

    def on_status(self, status: Status, arrived_s: float) -> None:
        """Add a Status that arrived at a time of this machine's wall clock, s; only a source's counts."""
        if status.role != "source":
            return
        with self._lock:
            if len(self._sources) >= _MOST_SOURCES and status.component not in self._sources:
                return
            source = self._sources.setdefault(status.component, _Source())
            source.seen_s = time.monotonic()
            source.bounds.on_stamp(status.stamp_ns / 1e9 - arrived_s)
            moved_s = source.bounds.step()
            if moved_s is None:
                return
            self.steps += 1
            text = f"the clock of {status.component} was set by {moved_s:+.3f} s"
            self._notes.append((time.monotonic(), text))
        _log.warning("%s", text)

    def on_trip(self, name: str, trip_s: float) -> None:
        """Add the time in s until the cache of a source's Status has answered."""
        with self._lock:
            if name in self._sources:
                self._sources[name].bounds.on_trip(trip_s)

    def _ask(self) -> None:
        while not self._closing.wait(_ASK_S):
            self._forget()
            with self._lock:
                names = list(self._sources)
            for name in names:
                if self._closing.is_set():
                    return
                self._ask_one(name)

    def _ask_one(self, name: str) -> None:
        key = f"{self._keys.stream('status', name)}/@adv/**"
        sent_s = time.monotonic()
        try:
            replies = self._session.get(key, timeout=_ANSWER_S, accept_replies=zenoh.ReplyKeyExpr.ANY)
            for reply in replies:
                if reply.ok is not None:
                    self.on_trip(name, time.monotonic() - sent_s)
                    return
        except zenoh.ZError:  # the session is being closed
            return

    def _forget(self) -> None:
        now = time.monotonic()
        with self._lock:
            self._sources = {n: s for n, s in self._sources.items() if now - s.seen_s < _FORGET_S}


def _shift(source: _Source) -> int:
    """Nanoseconds to take from the stamps of a source; changes only by what is worth it."""
    estimate = source.bounds.estimate()
    if estimate is not None:
        offset_s, error_s = estimate
        if abs(offset_s - source.applied_ns / 1e9) > max(_LEAST_CORRECTION_S, error_s):
            source.applied_ns = round(offset_s * 1e9)
    return source.applied_ns
