"""Values over time, found at any instant between two of them. Pure: no clock."""

from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

Value = TypeVar("Value")


class Timed(Generic[Value]):
    """The last values of something that changes, by their stamps.

    Parameters
    ----------
    between
        Interpolates between two values, by the share of the way from the first to the second.
    kept_ns
        How long values are kept; None: all of them.
    gap_ns
        Longest time between two values across which is interpolated.
    """

    def __init__(
        self, between: Callable[[Value, Value, float], Value], kept_ns: int | None, gap_ns: int
    ) -> None:
        self._between, self._kept_ns, self._gap_ns = between, kept_ns, gap_ns
        self._values: deque[tuple[int, Value]] = deque()

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest value; None before the first."""
        return self._values[-1][0] if self._values else None

    def add(self, stamp_ns: int, value: Value) -> bool:
        """Add a value; one that is not newer than the last is refused (False)."""
        if self._values and stamp_ns <= self._values[-1][0]:
            return False
        self._values.append((stamp_ns, value))
        while self._kept_ns is not None and self._values[0][0] < stamp_ns - self._kept_ns:
            self._values.popleft()
        return True

    def clear(self) -> None:
        """Forget all values."""
        self._values.clear()

    def at(self, stamp_ns: int) -> Value | None:
        """Value at an instant, interpolated; None beyond the values, and within a longer gap."""
        place = bisect_left(self._values, stamp_ns, key=lambda stamped: stamped[0])
        if place == len(self._values):
            return None
        late_ns, late = self._values[place]
        if late_ns == stamp_ns:
            return late
        if not place or late_ns - self._values[place - 1][0] > self._gap_ns:
            return None
        early_ns, early = self._values[place - 1]
        return self._between(early, late, (stamp_ns - early_ns) / (late_ns - early_ns))
