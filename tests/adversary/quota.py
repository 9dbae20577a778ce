"""Give a process a share of one core until it ends: ``PYTHONPATH=tests python -m adversary.quota PID SHARE``.

As a quota of a control group does, but without rights: in each period the process runs until all its threads
together have used their share of it, and is stopped for the rest. What it has used too much, because this
process came late, is taken off the next periods. Other load of the machine takes nothing from the share as
long as the process has priority (``nice -n -10``).
"""

import os
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

PERIOD_S = 0.02
_POLL_S = 0.001
# Nobody saves up more than this, nor owes more.
_MOST_S = 2 * PERIOD_S


def used_s(pid: int) -> float:
    """Processor time of the threads that a process has now, s."""
    total = 0
    for one in Path(f"/proc/{pid}/task").iterdir():
        with suppress(OSError):  # it has just ended
            total += int((one / "schedstat").read_text().split()[0])
    return total / 1e9


def limit(pid: int, share: float) -> None:
    """Hold a process to a share of a core until it ends."""
    before, left = used_s(pid), 0.0
    stopped, period_end = False, time.monotonic()
    while True:
        now, used = time.monotonic(), used_s(pid)
        left, before = max(left - max(used - before, 0.0), -_MOST_S), used
        while now >= period_end:
            period_end += PERIOD_S
            left = min(left + share * PERIOD_S, share * PERIOD_S)
        if stopped != (left <= 0):
            stopped = not stopped
            os.kill(pid, signal.SIGSTOP if stopped else signal.SIGCONT)
        time.sleep(_POLL_S)


def main(pid: str, share: str) -> None:
    """Limit it until it ends, or this process is told to end."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    try:
        with suppress(FileNotFoundError, ProcessLookupError):
            limit(int(pid), float(share))
    finally:
        with suppress(ProcessLookupError):
            os.kill(int(pid), signal.SIGCONT)


if __name__ == "__main__":
    main(*sys.argv[1:])
