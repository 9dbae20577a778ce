"""Writes a bounded number of lines to the log; defects with their traces."""

import logging
import time
from collections.abc import Callable

from ..event_time.faults import Fault

# A fault of one kind has its trace in the log once in this time, and so many lines are written at most.
_AGAIN_S = 60.0
_MOST_LINES = 20
_log = logging.getLogger(__name__)


class LogLimit:
    """Writes a bounded number of lines in a time, and says how many it has left out.

    Parameters
    ----------
    lines, seconds
        At most so many lines in so much time.
    """

    def __init__(self, lines: int, seconds: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._lines, self._seconds, self._clock = lines, seconds, clock
        self._began = clock()
        self._count = 0

    def log(self, logger: logging.Logger, level: int, text: str, *values: object) -> None:
        """Write a line, unless there were too many."""
        now = self._clock()
        if now - self._began >= self._seconds:
            if self._count > self._lines:
                logger.log(level, "%d more lines like these were left out", self._count - self._lines)
            self._began, self._count = now, 0
        self._count += 1
        if self._count <= self._lines:
            logger.log(level, text, *values)


class DefectLog:
    """Logs errors of the service itself, each kind with its trace once a minute."""

    def __init__(self) -> None:
        self._limit = LogLimit(_MOST_LINES, _AGAIN_S)
        self._logged_s: dict[str, float] = {}

    def write(self, fault: Fault) -> None:
        """Log a fault."""
        kind, now = f"{fault.what.partition('(')[0]}{fault.error}"[:200], time.monotonic()
        fresh = now - self._logged_s.get(kind, -_AGAIN_S) >= _AGAIN_S
        if fresh:
            self._logged_s = {logged: at for logged, at in self._logged_s.items() if now - at < _AGAIN_S}
            self._logged_s[kind] = now
        text, level = "a defect in %s: %s; please report this", logging.ERROR if fresh else logging.DEBUG
        self._limit.log(_log, level, text, fault.what, fault.error)
        for line in fault.trace.splitlines() if fresh else ():
            _log.error("  %s", line)
