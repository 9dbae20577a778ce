"""Stamps of observations in, the service's "now" out: the wall clock, or the newest event of a replay."""

import time
from typing import Literal, Protocol

from ..event_time.timeline import FUTURE_NS

ClockName = Literal["wall", "event"]
# How long no source may have followed the clock before a stamp far ahead is believed.
_PATIENCE_NS = 1_000_000_000


class Clock(Protocol):
    """Source of ``now_ns`` for the core."""

    def observe(self, stamp_ns: int, monotonic_ns: int) -> bool:
        """Take note of a stamp that came in, and when it came on the monotonic clock; both in ns.

        Returns
        -------
        bool
            Whether time starts over with this stamp.
        """

    def now_ns(self) -> int:
        """Nanoseconds since the Unix epoch."""


class WallClock:
    """The wall clock; sources are expected to agree with it."""

    def observe(self, stamp_ns: int, monotonic_ns: int) -> bool:
        """Do nothing: the wall clock does not follow the sources."""
        del stamp_ns, monotonic_ns
        return False

    def now_ns(self) -> int:
        """Wall clock time."""
        return time.time_ns()


class EventClock:
    """The newest stamp seen, for recordings whose stamps lie in the past.

    A stamp more than 1 s ahead counts only after 1 s in which no source has sent an older one: one
    wrong clock must not move the time of all sources, but a gap that all sources share must be crossed.
    After 1 s in which no source has kept the time, a stamp more than 1 s behind starts it over: a
    recording is replayed again.

    Parameters
    ----------
    now_ns
        Where the clock stands at the start; None: where the first stamp says.
    """

    def __init__(self, now_ns: int | None = None) -> None:
        self._now_ns = now_ns
        self._kept_ns: int | None = None

    def observe(self, stamp_ns: int, monotonic_ns: int) -> bool:
        """Advance to a stamp that is credible, or go back to it; returns whether time starts over."""
        now = self._now_ns
        idle = self._kept_ns is None or monotonic_ns - self._kept_ns > _PATIENCE_NS
        if now is None or idle:
            self._now_ns, self._kept_ns = stamp_ns, monotonic_ns
            if now is not None and stamp_ns >= now - FUTURE_NS:
                self._now_ns = max(now, stamp_ns)
            return now is not None and stamp_ns < now - FUTURE_NS
        if now - FUTURE_NS <= stamp_ns <= now + FUTURE_NS:
            self._now_ns = max(now, stamp_ns)
            self._kept_ns = monotonic_ns
        return False

    def now_ns(self) -> int:
        """Newest credible stamp; 0 before the first."""
        return self._now_ns or 0


def make_clock(name: ClockName, watermark_ns: int | None = None) -> Clock:
    """Clock by its name on the command line; `watermark_ns` is up to where everything is fused, if known."""
    return WallClock() if name == "wall" else EventClock(watermark_ns)
