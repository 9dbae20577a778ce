"""Writes a bounded number of lines to the log; defects with their traces."""

import logging
import time
from collections.abc import Callable

from ..event_time.faults import Fault

# Of each kind of line so many are written in so many seconds; so is the trace of a kind of defect once.
_MOST_LINES, _AGAIN_S = 20, 60.0


class _Limit(logging.Filter):
    """Lets a bounded number of lines of each text pass in a time, and says how many it has left out."""

    def __init__(self, clock: Callable[[], float]) -> None:
        super().__init__()
        self._clock = clock
        self._lines: dict[str, tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        now = self._clock()
        began, count = self._lines.get(record.msg, (now, 0))
        if now - began >= _AGAIN_S:
            if count > _MOST_LINES:
                text = "%d more lines like these were left out"
                logging.getLogger(record.name).log(record.levelno, text, count - _MOST_LINES)
            began, count = now, 0
        self._lines[record.msg] = began, count + 1
        return count < _MOST_LINES


def limited(name: str, clock: Callable[[], float] = time.monotonic) -> logging.Logger:
    """Return the logger of a name; of each text, as it is before it is filled in, it writes some lines."""
    logger = logging.getLogger(name)
    logger.addFilter(_Limit(clock))
    return logger


_log, _traces = limited(__name__), logging.getLogger(f"{__name__}.traces")


class DefectLog:
    """Logs errors of the service itself, each kind with its trace once a minute."""

    def __init__(self) -> None:
        self._logged_s: dict[str, float] = {}

    def write(self, fault: Fault) -> None:
        """Log a fault."""
        kind, now = f"{fault.doing.partition('(')[0]}{fault.error}"[:200], time.monotonic()
        self._logged_s = {logged: at for logged, at in self._logged_s.items() if now - at < _AGAIN_S}
        fresh = kind not in self._logged_s and len(self._logged_s) < _MOST_LINES
        level = logging.ERROR if fresh else logging.DEBUG
        _log.log(level, "a defect in %s: %s; please report this", fault.doing, fault.error)
        if fresh:
            self._logged_s[kind] = now
            for line in fault.trace.splitlines():
                _traces.error("  %s", line)
