"""Chooses the level of shedding from what updates take, and logs it: see :mod:`comotion.shedding`."""

import logging
import time
from dataclasses import dataclass

from ..shedding import MOST, Load, describe
from .log_limit import limited

_log = limited(__name__)


@dataclass
class Overload(Load):
    """Finds the level, and logs what is left out. Times are monotonic nanoseconds."""

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
