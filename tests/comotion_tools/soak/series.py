"""One fault at a time, again and again: kills of the service in a row, and each process stopped for long."""

import signal
import threading
import time

from .run import Runner
from .schedule import OTHERS, SOURCES, Fault

_RECOVERED_S = 60.0
_BETWEEN_S = 4.0


def kill_in_a_row(runner: Runner, count: int, stop: threading.Event) -> None:
    """Kill the service, start it again, and wait until all bodies have their hypotheses; `count` times."""
    monitor, service = runner.monitor, runner.processes["service"]
    for k in range(1, count + 1):
        if stop.is_set():
            return
        runner.result.faults.append((round(runner.now_s, 1), Fault(runner.now_s, "kill", "service")))
        sessions = len(monitor.findings.sessions)
        began = time.monotonic()
        service.signal(signal.SIGKILL)
        runner.expect("service")
        while len(monitor.findings.sessions) == sessions or not monitor.is_sorted_out:
            runner.turn()
            if stop.is_set() or time.monotonic() - began > _RECOVERED_S:
                break
        seconds = time.monotonic() - began
        runner.result.recovery.append(("kill service", seconds))
        changed = len(monitor.findings.changes)
        runner.say(
            f"kill {k} of {count}: all bodies again after {seconds:.2f} s, {changed} ids changed so far"
        )
        runner.wait(_BETWEEN_S)


def stop_each(runner: Runner, seconds: float) -> None:
    """Stop each process for some time and continue it."""
    for target in (*SOURCES, *OTHERS):
        if target in runner.processes:
            runner.carry_out(Fault(runner.now_s, "stop", target, seconds))
            runner.wait(2 * _BETWEEN_S)
