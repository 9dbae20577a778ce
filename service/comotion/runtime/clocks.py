"""Gives the service its "now", the wall clock or the newest event of a replay, its deadlines, and its load.

Deadlines neither drift nor bunch; the work for them begins so early that it is done in time.
"""

import logging
import time
from collections import deque
from dataclasses import dataclass
from typing import Literal

from ..event_time.timeline import FUTURE_NS
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
_log = limited(__name__)


class WallClock:
    """The wall clock as it was at the start, continued by one that is never set.

    When the clock of the machine is set, the core decides by the stamps whether the sources were set too. So
    no step of it stops the updates.
    """

    def __init__(self) -> None:
        self._offset_ns = _offset_ns()

    def observe(self, stamp_ns: int, monotonic_ns: int) -> None:
        """Ignore a stamp that came in at a time on the monotonic clock, ns: the event clock uses it."""

    def reach(self, stamp_ns: int) -> None:
        """Ignore a stamp that the core has accepted, ns: the event clock uses it."""

    def now_ns(self) -> int:
        """Wall clock time without its steps, ns since the Unix epoch."""
        drift = self.set_by_ns()
        if abs(drift) <= _SLEW_NS:
            self._offset_ns += drift
        return time.monotonic_ns() + self._offset_ns

    def set_by_ns(self) -> int:
        """By how much the clock of the machine has been set since the start, ns."""
        return _offset_ns() - self._offset_ns


class EventClock(WallClock):
    """The newest stamp seen, for recordings whose stamps lie in the past.

    A stamp more than 1 s ahead counts only after 1 s in which no source has sent an older one: one
    wrong clock must not move the time of all sources, but a gap that all sources share must be crossed.
    It begins at `now_ns`; None: at the first stamp.
    """

    def __init__(self, now_ns: int | None = None) -> None:
        super().__init__()
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

    def set_by_ns(self) -> int:
        """Always 0: this clock is not set."""
        return 0


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
        before_ns, self._spent_ns = self._spent_ns, time.thread_time_ns()
        self._cost_ns += (self._spent_ns - before_ns) * self.busy
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


def _offset_ns() -> int:
    """The wall clock minus the one that is never set, ns, by the closest pair of readings."""
    readings: list[tuple[int, int]] = []
    while not readings or (readings[-1][0] > _AT_ONCE_NS and len(readings) < _MOST_READINGS):
        before_ns, wall_ns, after_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        readings.append((after_ns - before_ns, wall_ns - after_ns))
    return min(readings)[1]
