"""Deadlines kept and missed in; the level of shedding out: see :mod:`comotion.shedding` for what it means.

The level rises by one when updates miss their deadlines again and again, and falls to 0 at once after some
seconds without a miss. When the full work is too much again right away, the next return waits twice as long.
"""

import logging
from collections import deque
from dataclasses import dataclass, field

from ..shedding import MOST, describe
from .guard import LogLimit

# So many misses among so many updates raise the level.
_MISSES, _AMONG = 3, 10
# ns without a miss after which all is done again; twice that after each return that did not last as long.
_CALM_NS = 5_000_000_000
_LONGEST_CALM_NS = 80_000_000_000
_log = logging.getLogger(__name__)


@dataclass
class Overload:
    """Decides what to leave out. Times are monotonic nanoseconds.

    Attributes
    ----------
    level
        From 0, nothing is left out, to :data:`comotion.shedding.MOST`.
    """

    level: int = 0
    _recent: deque[bool] = field(default_factory=lambda: deque(maxlen=_AMONG))
    _calm_ns: int = _CALM_NS
    _missed_ns: int = 0
    _returned_ns: int | None = None
    _limit: LogLimit = field(default_factory=lambda: LogLimit(10, 60.0))

    def note(self, *, missed: bool, at_ns: int) -> int:
        """Take note of whether an update has missed its deadline; returns the level from now on."""
        self._recent.append(missed)
        if missed:
            self._missed_ns = at_ns
            if sum(self._recent) >= _MISSES and self.level < MOST:
                self._rise(at_ns)
        elif self.level and at_ns - self._missed_ns >= self._calm_ns:
            self.level, self._returned_ns = 0, at_ns
            self._limit.log(_log, logging.INFO, "updates are on time again: nothing is left out")
        return self.level

    def _rise(self, at_ns: int) -> None:
        if self.level == 0:
            early = self._returned_ns is not None and at_ns - self._returned_ns < self._calm_ns
            self._calm_ns = min(2 * self._calm_ns, _LONGEST_CALM_NS) if early else _CALM_NS
        self.level += 1
        self._recent.clear()
        level = logging.WARNING if self.level == 1 else logging.INFO
        self._limit.log(_log, level, "%s", *self.notes())

    def notes(self) -> list[str]:
        """The reason, in words, for the Status; empty while nothing is left out."""
        if not self.level:
            return []
        return [f"updates take longer than a period (level {self.level} of {MOST}): {describe(self.level)}"]
