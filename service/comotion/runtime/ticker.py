"""Sets deadlines that neither drift nor bunch, and when to start for them."""

from collections import deque

# Updates whose durations are remembered: two seconds of them at the default period.
_REMEMBERED = 20
# Single updates, with births or splits, take longer than any of those before them.
_SLOWER = 1.5


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
        """Go to the first deadline after now; returns how many were skipped."""
        skipped = max(0, (now_ns - self._due_ns) // self._period_ns)
        self._due_ns += (skipped + 1) * self._period_ns
        return skipped


class HeadStart:
    """How long before a deadline to begin, so that the work is done at the deadline.

    One and a half times the longest of the recent durations, at most 95 % of a period. Results leave
    evenly spaced; the price is that a result waits when its work took less.
    """

    def __init__(self, period_ns: int) -> None:
        self._longest_ns = 19 * period_ns // 20
        self._durations: deque[int] = deque(maxlen=_REMEMBERED)

    @property
    def ns(self) -> int:
        """Nanoseconds before the deadline."""
        return min(round(_SLOWER * max(self._durations, default=0)), self._longest_ns)

    def note(self, duration_ns: int) -> None:
        """Take note of how long the work has taken."""
        self._durations.append(duration_ns)
