"""Measures how far the clocks of sources are ahead of the service's; corrects batches if wanted.

Each source sends a Status a second, stamped by its host's clock. With the round trip of a query to the cache
of that publisher, it tells the difference of the clocks within half of the round trip. Stamps of observations
are not used: they are those of acquisition, and how long acquisition takes is unknown.
"""

import time
from collections import deque
from dataclasses import dataclass, field, replace

import zenoh
from zenoh.handlers import Callback

from comotion_schemas import ObservationBatch, Status
from comotion_schemas.clock_bounds import ClockBounds
from comotion_schemas.component import Component

from .log_limit import limited

_QUERY_EVERY_S = 1.5  # between two queries of a source, so that every second Status brings one
_ANSWER_S = 1.0  # a slower answer is of no use
_FORGET_S = 60.0  # after the last token or Status of a source
# A step is worth a note for so long.
_NOTED_S = 60.0
_NOTES = 8
_MOST_SOURCES = 1024
# Corrections smaller than this, or than the error of the estimate, are not worth a jump in the stamps.
_LEAST_CORRECTION_S = 0.001
_log = limited(__name__)


@dataclass
class _Source:
    bounds: ClockBounds = field(default_factory=ClockBounds)
    seen_s: float = 0.0
    queried_s: float = -_QUERY_EVERY_S
    applied_ns: int = 0


class SourceClocks:
    """Follows the clocks of the sources of a scene; `correct` says whether :meth:`correct` shifts stamps.

    `steps` counts how often one was set while it was followed.
    """

    def __init__(self, component: Component, *, correct: bool) -> None:
        self.steps = 0
        self._session = component.session
        self._keys = component.keys
        self._correct = correct
        self._sources: dict[str, _Source] = {}
        self._notes: deque[tuple[float, str]] = deque(maxlen=_NOTES)
        # Names and round trips in s; Zenoh's threads add to it.
        self._answers: deque[tuple[str, float]] = deque(maxlen=_MOST_SOURCES)

    def offsets(self) -> dict[str, float]:
        """How far each source's clock is ahead of this one's, in s; none for those unknown or gone."""
        now = time.monotonic()
        self._take_answers()
        self._sources = {n: s for n, s in self._sources.items() if now - s.seen_s < _FORGET_S}
        estimates = {name: source.bounds.estimate() for name, source in self._sources.items()}
        return {name: estimate[0] for name, estimate in sorted(estimates.items()) if estimate is not None}

    def notes(self) -> list[str]:
        """Steps of the last minute, in words."""
        now = time.monotonic()
        return [text for at, text in self._notes if now - at < _NOTED_S]

    def correct(self, batch: ObservationBatch) -> ObservationBatch:
        """Return a batch with its stamps by this clock, if that is wanted and the difference is known."""
        if not self._correct:
            return batch
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
        self._take_answers()
        name, now = status.component, time.monotonic()
        if len(self._sources) >= _MOST_SOURCES and name not in self._sources:
            return
        source = self._sources.setdefault(name, _Source())
        source.seen_s = now
        if now - source.queried_s >= _QUERY_EVERY_S:
            source.queried_s = now
            self._query(name, now)
        source.bounds.on_stamp(status.stamp_ns / 1e9 - arrived_s)
        moved_s = source.bounds.step()
        if moved_s is not None:
            self.steps += 1
            text = f"the clock of {name} was set by {moved_s:+.3f} s"
            self._notes.append((now, text))
            _log.warning("%s", text)

    def on_trip(self, name: str, trip_s: float) -> None:
        """Add the time in s until the cache of a source's Status has answered."""
        if name in self._sources:
            self._sources[name].bounds.on_trip(trip_s)

    def _take_answers(self) -> None:
        while self._answers:
            self.on_trip(*self._answers.popleft())

    def _query(self, name: str, sent_s: float) -> None:
        """Query the cache of a source's Status."""

        def answered(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                self._answers.append((name, time.monotonic() - sent_s))

        key = f"{self._keys.stream('status', name)}/@adv/**"
        self._session.get(key, Callback(answered), timeout=_ANSWER_S, accept_replies=zenoh.ReplyKeyExpr.ANY)


def _shift(source: _Source) -> int:
    """Nanoseconds to take from the stamps of a source; changes only by a step that is worth it."""
    estimate = source.bounds.estimate()
    if estimate is not None:
        offset_s, error_s = estimate
        if abs(offset_s - source.applied_ns / 1e9) > max(_LEAST_CORRECTION_S, error_s):
            source.applied_ns = round(offset_s * 1e9)
    return source.applied_ns
