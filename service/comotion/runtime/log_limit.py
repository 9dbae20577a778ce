"""Writes a bounded number of lines to the log; defects with their traces."""

import logging
import time

from ..event_time.faults import Fault

# Of each kind of line so many are written in so many seconds; a defect, with its trace, once.
_MOST_LINES, _AGAIN_S = 20, 60.0


class _Limit(logging.Filter):
    """Lets a bounded number of lines of each text pass in a time, and says how many it has left out."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self._most = most
        self._lines: dict[str, tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        now = time.monotonic()
        began, count = self._lines.get(record.msg, (now, 0))
        if now - began >= _AGAIN_S:
            if count > self._most:
                text = "%d more lines like these were left out"
                logging.getLogger(record.name).log(record.levelno, text, count - self._most)
            began, count = now, 0
        self._lines[record.msg] = began, count + 1
        return count < self._most


def limited(name: str, most: int = _MOST_LINES) -> logging.Logger:
    """Return the logger of a name; of each text, as it is before it is filled in, it writes `most` lines."""
    logger = logging.getLogger(name)
    logger.addFilter(_Limit(most))
    return logger


_defects = limited(__name__, most=1)


def log_defect(fault: Fault) -> None:
    """Log an error of the service itself with its trace, each kind once a minute."""
    doing, *batch = fault.doing.partition(" (")
    # The kind is a part of the text, by which lines are counted.
    kind = f"{doing}: {type(fault.error).__name__}".replace("%", "%%")
    _defects.error(f"a defect in {kind}; please report this%s", "".join(batch), exc_info=fault.error)
