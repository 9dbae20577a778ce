"""A soak of some seconds: the real system under two faults."""

import signal
import threading

import pytest

from comotion_tools.soak.run import Runner
from comotion_tools.soak.schedule import Fault

# A minute under load; CI runs "make soak", which has the same faults and more.
pytestmark = [pytest.mark.e2e, pytest.mark.long]


def test_after_a_kill_of_the_service_all_is_as_before(free_port_endpoint, tmp_path) -> None:
    said: list[str] = []
    with Runner(free_port_endpoint, tmp_path, threading.Event(), said.append) as runner:
        runner.settle()
        runner.wait(3.0)
        labels = dict(runner.monitor.labels)
        assert len(labels) == 6
        runner.run([Fault(0.0, "kill", "left"), Fault(0.5, "kill", "service")], 1.0)
        while len(runner.monitor.findings.sessions) < 2 or not runner.monitor.is_sorted_out:
            runner.turn()
        runner.wait(3.0)
        assert runner.monitor.labels == labels
    assert runner.monitor.findings.reused == []
    assert runner.result.ended == {}
    assert {name: process.ended[0] for name, process in runner.processes.items() if process.starts > 1} == {
        "left": -signal.SIGKILL,
        "service": -signal.SIGKILL,
    }
