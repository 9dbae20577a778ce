"""Chooses the level of shedding from what updates take, and logs it: see :mod:`comotion.shedding`."""

import logging
from dataclasses import dataclass, field

from ..shedding import MOST, Load, describe
from .guard import LogLimit

_log = logging.getLogger(__name__)


@dataclass
class Overload:
    """Says what is left out. Times are monotonic nanoseconds.

    Attributes
    ----------
    period_ns
        Time between updates.
    """

    period_ns: int
    _load: Load = field(init=False)
    _limit: LogLimit = field(default_factory=lambda: LogLimit(10, 60.0))

    def __post_init__(self) -> None:
        self._load = Load(self.period_ns)

    @property
    def level(self) -> int:
        """From 0, nothing is left out, to :data:`comotion.shedding.MOST`."""
        return self._load.level

    def note(self, took_ns: int, at_ns: int) -> int:
        """Take note of how long an update took; returns the level from now on."""
        before = self.level
        level = self._load.note(took_ns, at_ns)
        if level > before:
            kind = logging.INFO if before else logging.WARNING
            self._limit.log(_log, kind, "%s", *self.notes())
        elif before and not level:
            self._limit.log(_log, logging.INFO, "updates are on time again: nothing is left out")
        return level

    def notes(self) -> list[str]:
        """The reason, in words, for the Status; empty while nothing is left out."""
        if not self.level:
            return []
        return [f"updates take longer than a period (level {self.level} of {MOST}): {describe(self.level)}"]
