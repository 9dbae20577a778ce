"""Give a process a share of one core until it ends: ``quota.py PID SHARE``.

As a quota of a control group does, but without rights: in each period the process runs until all its threads
together have used their share of it, and is stopped for the rest; what it has used too much is taken off the
next periods.
"""

import os
import signal
import sys
import time
from contextlib import suppress

PERIOD_S = 0.02


def limit(pid: int, share: float) -> None:
    """Hold a process to a share of a core until it ends, which is an OSError."""
    processor = ~pid << 3 | 2  # the clock of its processor time, as clock_getcpuclockid has it
    used, left, stopped, end = time.clock_gettime(processor), 0.0, False, time.monotonic()
    while True:
        before, used = used, time.clock_gettime(processor)
        # Nobody owes more than two periods, and nobody saves up.
        left = max(left - (used - before), -2 * PERIOD_S)
        while time.monotonic() >= end:
            end += PERIOD_S
            left = min(left, 0.0) + share * PERIOD_S
        if stopped != (left <= 0):
            stopped = not stopped
            os.kill(pid, signal.SIGSTOP if stopped else signal.SIGCONT)
        time.sleep(PERIOD_S / 20)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    limited = int(sys.argv[1])
    try:
        with suppress(OSError):
            limit(limited, float(sys.argv[2]))
    finally:
        with suppress(OSError):
            os.kill(limited, signal.SIGCONT)
