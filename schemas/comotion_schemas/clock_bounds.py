"""Bounds how far another host's clock is ahead, by stamps and round trips. Pure.

A stamp that arrives bounds the difference from below, for it was made before; a stamp that answers a query
bounds it from above too, for it was made after the query. What comes by itself, like a Status, is taken to
travel no longer than a query to its publisher's cache and back.
"""

from collections import deque
from dataclasses import dataclass, field
from math import inf, isfinite

WINDOW = 10
"""Newest stamps that count: Statuses of ten seconds."""
_STEPS = 3
# A clock that is set moves by more than what delays vary by.
_LEAST_STEP_S = 0.01


@dataclass
class ClockBounds:
    """Bounds of how far a clock is ahead of this machine's, over the last stamps; all times in s."""

    _stamps: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=WINDOW))
    _trips: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW))

    def on_stamp(self, ahead_s: float) -> None:
        """Add a stamp that came by itself; `ahead_s` is the stamp minus the time of its arrival."""
        self._stamps.append((ahead_s, inf))

    def on_answer(self, stamp_s: float, sent_s: float, received_s: float) -> None:
        """Add a stamp that answers a query."""
        self._stamps.append((stamp_s - received_s, stamp_s - sent_s))

    def on_trip(self, trip_s: float) -> None:
        """Add the time until the publisher's cache has answered."""
        self._trips.append(trip_s)

    def estimate(self) -> tuple[float, float] | None:
        """Return (how far the clock is ahead, bound of the error); None while unknown."""
        least_s = max((least for least, _ in self._stamps), default=-inf)
        most_s = min((most for _, most in self._stamps), default=inf)
        most_s = min(most_s, least_s + min(self._trips, default=inf))
        if not (isfinite(least_s) and isfinite(most_s)):
            return None
        return (least_s + most_s) / 2, abs(most_s - least_s) / 2

    def step(self) -> float | None:
        """Return by how much the clock was set, if it was, and forget what was before; else None.

        The last three stamps must agree that it was, within the variation of the delay.
        """
        if len(self._stamps) < 2 * _STEPS or not self._trips:
            return None
        recent, earlier = list(self._stamps)[-_STEPS:], list(self._stamps)[:-_STEPS]
        ahead = [least for least, _ in recent]
        moved_s = max(ahead) - max(least for least, _ in earlier)
        # A link that has become slow delays the round trips as well.
        tolerance_s = max(_LEAST_STEP_S, 2 * max(list(self._trips)[-_STEPS:]))
        if abs(moved_s) <= tolerance_s or max(ahead) - min(ahead) > tolerance_s:
            return None
        if moved_s > 0 and min(ahead) < max(least for least, _ in earlier) + tolerance_s:
            return None
        self._stamps.clear()
        self._stamps.extend(recent)
        return moved_s
