"""Presence of a process: token, Status, readiness, signals, a router that comes late."""

import signal
import sys
import threading

import zenoh

from comotion_schemas import Keys
from comotion_schemas.component import Component
from comotion_schemas.transport import SessionSettings

from .conftest import DEADLINE, routing

KEYS = Keys()


def component(endpoint, **changes):
    fields = {"role": "source", "name": "cam", "settings": SessionSettings(connect=(endpoint,))}
    return Component(**(fields | changes))


def test_a_component_is_present_and_its_ready_file_is_there_while_it_is_open(
    endpoint, session, listen, tmp_path
):
    presence = session.liveliness().declare_subscriber(KEYS.all_live(), history=True)
    file = tmp_path / "ready"
    with component(endpoint, ready_file=file) as one:
        sample = presence.recv()
        assert (str(sample.key_expr), sample.kind) == (KEYS.live("source", "cam"), zenoh.SampleKind.PUT)
        # Who joins late gets the last Status.
        assert listen(session, KEYS.streams("status"), "status").next().component == "cam"
        assert not file.exists()
        one.ready()
        assert file.exists()
    assert presence.recv().kind == zenoh.SampleKind.DELETE
    assert list(tmp_path.iterdir()) == []
    presence.undeclare()


def test_a_status_that_fails_is_reported_and_does_not_end_the_reporting(endpoint, session, listen):
    statuses = listen(session, KEYS.stream("status", "cam"), "status")

    def fail():
        raise RuntimeError("a defect")

    with component(endpoint, status=fail):
        for _ in range(2):
            status = statuses.next()
            assert status.state == "degraded"
            assert "a defect" in status.message


def test_it_waits_for_a_router_that_comes_late(free_port_endpoint, listen):
    late = component(free_port_endpoint)
    opening = threading.Thread(target=late.__enter__)
    opening.start()
    opening.join(1.0)
    assert opening.is_alive()
    with routing(free_port_endpoint) as router:
        opening.join(DEADLINE)
        assert listen(router, KEYS.stream("status", "cam"), "status").next().component == "cam"
        late.__exit__(None, None, None)


HANGS = """
import sys
from comotion_schemas.component import Component
from comotion_schemas.transport import SessionSettings
with Component(role="source", name="cam", settings=SessionSettings(connect=[sys.argv[1]])) as component:
    component.ready()
    component.stop.wait()
    print("stopping", flush=True)
    while True:
        pass
"""


def test_a_second_signal_ends_one_that_hangs(endpoint, start):
    process = start.any(sys.executable, "-c", HANGS, endpoint)
    process.wait_ready()
    process.signal(signal.SIGTERM)
    process.wait_line(lambda line: line == "stopping")
    process.signal(signal.SIGTERM)
    assert process.wait() == -signal.SIGTERM
