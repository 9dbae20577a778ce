"""Stamps of observations in, the service's "now" out: the wall clock, or the newest event of a replay."""

import time
from typing import Literal, Protocol

from ..event_time.timeline import FUTURE_NS

ClockName = Literal["wall", "event"]
# How long no source may have followed the clock before a stamp far ahead is believed.
_PATIENCE_NS = 1_000_000_000


class Clock(Protocol):
    """Source of ``now_ns`` for the core."""

    def observe(self, stamp_ns: int, monotonic_ns: int) -> None:
        """Take note of a stamp that came in, and when it came on the monotonic clock; both in ns."""

    def now_ns(self) -> int:
        """Nanoseconds since the Unix epoch."""


class WallClock:
    """The wall clock; sources are expected to agree with it."""

    def observe(self, stamp_ns: int, monotonic_ns: int) -> None:
        """Do nothing: the wall clock does not follow the sources."""

    def now_ns(self) -> int:
        """Wall clock time."""
        return time.time_ns()


class EventClock:
    """The newest stamp seen, for recordings whose stamps lie in the past.

    A stamp more than 1 s ahead counts only after 1 s in which no source has sent an older one: one
    wrong clock must not move the time of all sources, but a gap that all sources share must be crossed.
    """

    def __init__(self) -> None:
        self._now_ns: int | None = None
        self._kept_ns = 0

    def observe(self, stamp_ns: int, monotonic_ns: int) -> None:
        """Advance to a stamp that is credible; the clock never goes back."""
        now = self._now_ns
        if now is None or stamp_ns <= now + FUTURE_NS or monotonic_ns - self._kept_ns > _PATIENCE_NS:
            self._now_ns = stamp_ns if now is None else max(now, stamp_ns)
            self._kept_ns = monotonic_ns

    def now_ns(self) -> int:
        """Newest credible stamp; 0 before the first."""
        return self._now_ns or 0


def make_clock(name: ClockName) -> Clock:
    """Clock by its name on the command line."""
    return WallClock() if name == "wall" else EventClock()
