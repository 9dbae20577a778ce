"""The clocks of the service and of its sources.

The service has its "now", the wall clock or the newest event of a replay, its deadlines, and its load.
Deadlines neither drift nor bunch; the work for them begins so early that it is done in time.

How far the clocks of sources are ahead is measured, and batches are corrected if wanted. Each source sends a
Status a second, stamped by its host's clock. With the round trip of a query to the cache of that publisher,
it tells the difference of the clocks within half of the round trip. Stamps of observations are not used: they
are those of acquisition, and how long acquisition takes is unknown.
"""

import logging
import time
from collections import deque
from dataclasses import dataclass, field, replace
from math import inf
from typing import Literal

import zenoh
from zenoh.handlers import Callback

from comotion_schemas import ObservationBatch, Status
from comotion_schemas.clock_bounds import ClockBounds
from comotion_schemas.component import Component

from ..event_time.clocks import FUTURE_NS
from ..event_time.sources import MAX_SOURCES
from ..shedding import MOST, Load, describe
from .log_limit import limited

ClockName = Literal["wall", "event"]
# Time daemons slew the clock by less between two readings; more is a step.
_SLEW_NS = 50_000_000
# Readings of both clocks take less, unless another process had the processor: then they are repeated.
_AT_ONCE_NS, _MOST_READINGS = 1_000_000, 5
# How long no source may have followed the clock before a stamp far ahead is believed.
_UNFOLLOWED_NS = 1_000_000_000
# Updates whose durations are remembered: two seconds of them at the default period.
_REMEMBERED = 20
# Single updates, with births or splits, take longer than any of those before them.
_SLOWER = 1.5
_QUERY_EVERY_S = 1.5  # between two queries of a source, so that every second Status brings one
_ANSWER_S = 1.0  # a slower answer is of no use
_FORGET_S = 60.0  # after the last token or Status of a source
# A step is worth a note for so long.
_NOTED_S = 60.0
_NOTES = 8
# Corrections smaller than this, or than the error of the estimate, are not worth a jump in the stamps.
_LEAST_CORRECTION_S = 0.001
_log = limited(__name__)


class WallClock:
    """The wall clock as it was at the start, continued by one that is never set.

    When the clock of the machine is set, the core decides by the stamps whether the sources were set too. So
    no step of it stops the updates.
    """

    def __init__(self) -> None:
        self._offset_ns = _offset_ns()

    def now_ns(self) -> int:
        """Wall clock time without its steps, ns since the Unix epoch."""
        drift = self.set_by_ns()
        if abs(drift) <= _SLEW_NS:
            self._offset_ns += drift
        return time.monotonic_ns() + self._offset_ns

    def set_by_ns(self) -> int:
        """By how much the clock of the machine has been set since the start, ns."""
        return _offset_ns() - self._offset_ns


class EventClock:
    """The newest stamp seen, for recordings whose stamps lie in the past.

    A stamp more than 1 s ahead counts only after 1 s in which no source has sent an older one: one
    wrong clock must not move the time of all sources, but a gap that all sources share must be crossed.
    It begins at `now_ns`; None: at the first stamp.
    """

    def __init__(self, now_ns: int | None = None) -> None:
        self._now_ns = now_ns
        self._kept_ns = 0

    def observe(self, stamp_ns: int, monotonic_ns: int) -> None:
        """Advance to a stamp that is credible; the clock never goes back."""
        now = self._now_ns
        if now is None or stamp_ns <= now + FUTURE_NS or monotonic_ns - self._kept_ns > _UNFOLLOWED_NS:
            self._now_ns = stamp_ns if now is None else max(now, stamp_ns)
            self._kept_ns = monotonic_ns

    def reach(self, stamp_ns: int) -> None:
        """Advance to a stamp that the core has accepted."""
        self._now_ns = max(self._now_ns or 0, stamp_ns)

    def now_ns(self) -> int:
        """Newest credible stamp; 0 before the first."""
        return self._now_ns or 0


class Ticker:
    """Deadlines at start + k·period, k = 1, 2, ..., and how long before them to begin.

    The head start is one and a half times the longest of the recent durations, at most 95 % of a period: the
    work is done at the deadline, and results leave evenly spaced. The price is that a result waits when its
    work took less. Times are those of a monotonic clock in nanoseconds; the caller reads it.
    """

    def __init__(self, period_ns: int, start_ns: int) -> None:
        self._period_ns = period_ns
        self._due_ns = start_ns + period_ns
        self._durations: deque[int] = deque(maxlen=_REMEMBERED)

    @property
    def head_start_ns(self) -> int:
        """Time before the deadline at which to begin."""
        return min(round(_SLOWER * max(self._durations, default=0)), 19 * self._period_ns // 20)

    def note(self, duration_ns: int) -> None:
        """Take note of how long the work has taken."""
        self._durations.append(duration_ns)

    def remaining_ns(self, now_ns: int) -> int:
        """Time until the next deadline, negative when it has passed."""
        return self._due_ns - now_ns

    def advance(self, now_ns: int) -> int:
        """Go to the first deadline after now; returns how many were skipped."""
        skipped = max(0, (now_ns - self._due_ns) // self._period_ns)
        self._due_ns += (skipped + 1) * self._period_ns
        return skipped


@dataclass
class Overload(Load):
    """Finds the level of shedding (:mod:`comotion.shedding`), and logs what is left out."""

    _cost_ns: float = 0.0
    _spent_ns: int = 0

    def cost_ns(self) -> int:
        """Cost of this thread so far: on a busy machine a second of its processor time takes longer."""
        last_ns, self._spent_ns = self._spent_ns, time.thread_time_ns()
        self._cost_ns += (self._spent_ns - last_ns) * self.busy
        return int(self._cost_ns)

    def note(self, took_ns: int, spent_ns: int, at_ns: int) -> int:
        """Take note of how long an update took, and its processor time; returns the level from now on."""
        previous = self.level
        level = super().note(took_ns, spent_ns, at_ns)
        if level > previous:
            kind = logging.INFO if previous else logging.WARNING
            _log.log(kind, "%s", *self.notes())
        elif previous and not level:
            _log.info("updates are on time again: nothing is left out")
        return level

    def notes(self) -> list[str]:
        """The reason, in words, for the Status; empty while nothing is left out."""
        if not self.level:
            return []
        return [f"updates take longer than a period (level {self.level} of {MOST}): {describe(self.level)}"]


@dataclass
class _Source:
    bounds: ClockBounds = field(default_factory=ClockBounds)
    seen_s: float = 0.0
    queried_s: float = -_QUERY_EVERY_S
    applied_ns: int = 0

    def shift_ns(self) -> int:
        """Nanoseconds to take from its stamps; changes only by a step that is worth it."""
        offset_s, error_s = self.bounds.estimate() or (0.0, inf)
        if abs(offset_s - self.applied_ns / 1e9) > max(_LEAST_CORRECTION_S, error_s):
            self.applied_ns = round(offset_s * 1e9)
        return self.applied_ns


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
        self._answers: deque[tuple[str, float]] = deque(maxlen=MAX_SOURCES)

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
        source = self._sources.get(batch.source) if self._correct else None
        shift_ns = 0 if source is None else source.shift_ns()
        if not shift_ns:
            return batch
        stamps = None if batch.stamps_ns is None else batch.stamps_ns - shift_ns
        return replace(batch, stamp_ns=batch.stamp_ns - shift_ns, stamps_ns=stamps)

    def on_status(self, status: Status, arrived_s: float) -> None:
        """Add the Status of a source that arrived at a time of this machine's wall clock, s."""
        self._take_answers()
        name, now = status.component, time.monotonic()
        if len(self._sources) >= MAX_SOURCES and name not in self._sources:
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

    def _take_answers(self) -> None:
        while self._answers:
            name, trip_s = self._answers.popleft()
            if name in self._sources:
                self._sources[name].bounds.on_trip(trip_s)

    def _query(self, name: str, sent_s: float) -> None:
        def answered(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                self._answers.append((name, time.monotonic() - sent_s))

        key = f"{self._keys.stream('status', name)}/@adv/**"
        self._session.get(key, Callback(answered), timeout=_ANSWER_S, accept_replies=zenoh.ReplyKeyExpr.ANY)


def _offset_ns() -> int:
    """The wall clock minus the one that is never set, ns, by the closest pair of readings."""
    readings: list[tuple[int, int]] = []
    while not readings or (readings[-1][0] > _AT_ONCE_NS and len(readings) < _MOST_READINGS):
        begin_ns, wall_ns, end_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        readings.append((end_ns - begin_ns, wall_ns - end_ns))
    return min(readings)[1]
