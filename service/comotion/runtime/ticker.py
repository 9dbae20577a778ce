"""Deadlines at a fixed period that neither drift nor bunch."""


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
