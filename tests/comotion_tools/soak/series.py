"""One fault at a time, again and again: kills of the service in a row, and each process stopped for long."""

import time

from .run import Runner
from .schedule import OTHERS, SOURCES, Fault

_RECOVERED_S = 60.0
_BETWEEN_S = 4.0


def kill_in_a_row(runner: Runner, count: int) -> None:
    """Kill the service, start it again, and wait until all bodies have their hypotheses; `count` times."""
    for k in range(1, count + 1):
        if runner.stop.is_set():
            return
        seconds = _recovery_s(runner)
        runner.result.recovery.append(("kill service", seconds))
        changed = len(runner.monitor.findings.changes)
        runner.say(
            f"kill {k} of {count}: all bodies again after {seconds:.2f} s, {changed} ids changed so far"
        )
        runner.wait(_BETWEEN_S)


def _recovery_s(runner: Runner) -> float:
    """Kill the service; how long until all bodies have their hypotheses again, at most a minute."""
    monitor, began = runner.monitor, time.monotonic()
    sessions = len(monitor.findings.sessions)
    runner.carry_out(Fault(runner.now_s, "kill", "service"))
    runner.is_so(lambda: len(monitor.findings.sessions) > sessions and monitor.is_sorted_out, _RECOVERED_S)
    return time.monotonic() - began


def stop_each(runner: Runner, seconds: float) -> None:
    """Stop each process for some time and continue it."""
    for target in (*SOURCES, *OTHERS):
        if target in runner.processes:
            runner.carry_out(Fault(runner.now_s, "stop", target, seconds))
            runner.wait(2 * _BETWEEN_S)
