"""Deadlines at a fixed period that neither drift nor bunch, and when to start for them."""

from collections import deque

_REMEMBERED = 20
# Births and splits make single updates longer than any before them.
_MARGIN = 1.5


class Ticker:
    """Deadlines at start + k·period, k = 1, 2, ...

    Times are those of a monotonic clock in nanoseconds; the caller reads it.
    """

    def __init__(self, period_ns: int, start_ns: int) -> None:
        self._period_ns = period_ns
        self._due_ns = start_ns + period_ns

    def remaining_ns(self, now_ns: int) -> int:
        """Time until the next deadline, negative when it has passed."""
        return self._due_ns - now_ns

    def advance(self, now_ns: int) -> int:
        """Go to the first deadline after now; answers how many were skipped on the way."""
        skipped = max(0, (now_ns - self._due_ns) // self._period_ns)
        self._due_ns += (skipped + 1) * self._period_ns
        return skipped


class HeadStart:
    """How long before a deadline to begin, so that work of varying length is done when it comes.

    One and a half times the longest of the recent durations, at most 95 % of a period: results leave
    evenly spaced, at the price of being older by what is not needed.
    """

    def __init__(self, period_ns: int) -> None:
        self._longest_ns = 19 * period_ns // 20
        self._durations: deque[int] = deque(maxlen=_REMEMBERED)

    @property
    def ns(self) -> int:
        """Nanoseconds before the deadline."""
        return min(round(_MARGIN * max(self._durations, default=0)), self._longest_ns)

    def note(self, duration_ns: int) -> None:
        """Learn from how long the work has taken."""
        self._durations.append(duration_ns)
