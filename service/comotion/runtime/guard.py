"""Keeps the service running after an exception; logs defects with their traces, within bounds."""

import logging
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager

# A fault of one kind has its trace in the log once in this time, and so many lines are written at most.
_AGAIN_S = 60.0
_MOST_LINES = 20
_log = logging.getLogger(__name__)


class LogLimit:
    """Writes a bounded number of lines in a time, and says how many it has left out.

    Parameters
    ----------
    lines, seconds
        How many in which time.
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


class Guard:
    """Keeps defects from ending the loop.

    Parameters
    ----------
    count
        Called for each exception.
    """

    def __init__(self, count: Callable[[], None]) -> None:
        self._count = count
        self._limit = LogLimit(_MOST_LINES, _AGAIN_S)
        self._logged_s: dict[str, float] = {}

    @contextmanager
    def __call__(self, what: str) -> Iterator[None]:
        """Go on after an exception in a block that does `what`."""
        try:
            yield
        except Exception as error:  # whatever it is, the service goes on
            self._count()
            self.log(what, error)

    def log(self, what: str, error: object, trace: str | None = None) -> None:
        """Log a defect; its trace once a minute for defects of a kind."""
        kind, now = f"{what.partition('(')[0]}{type(error).__name__}{error}"[:200], time.monotonic()
        fresh = now - self._logged_s.get(kind, -_AGAIN_S) >= _AGAIN_S
        if fresh:
            self._logged_s = {one: at for one, at in self._logged_s.items() if now - at < _AGAIN_S}
            self._logged_s[kind] = now
        text = "a defect in %s: %s; please report this"
        if not fresh:
            self._limit.log(_log, logging.DEBUG, text, what, error)
            return
        self._limit.log(_log, logging.ERROR, text, what, error)
        for line in (trace or traceback.format_exc()).splitlines():
            _log.error("  %s", line)
