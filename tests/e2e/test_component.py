"""Presence of a process: token, Status, readiness, signals; which of several services goes on."""

import signal
import sys
import threading
import time
from dataclasses import replace

import pytest
import zenoh

from comotion import Fusion
from comotion.runtime import presence
from comotion.runtime.presence import Presence, SceneTakenError
from comotion_schemas import Keys, encode
from comotion_schemas.component import Component
from comotion_schemas.transport import SessionSettings

from .conftest import routing
from .waiting import DEADLINE

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


OTHER = "b" * 16
UPDATE = Fusion(session=OTHER).update(0)
OLD_CLAIM = f"x-{1:016x}-{OTHER}"


@pytest.fixture(autouse=True)
def _impatient(monkeypatch):
    monkeypatch.setattr(presence, "_PATIENCE_S", 0.3)
    monkeypatch.setattr(presence, "_START_S", 0.3)
    monkeypatch.setattr(presence, "_SETTLE_NS", 50_000_000)


@pytest.fixture
def service(free_port_endpoint):
    settings = SessionSettings(mode="router", connect=(), listen=(free_port_endpoint,))
    with Component(role="service", name="fusion", settings=settings, has_token=False) as service:
        yield service


@pytest.fixture
def other(service, free_port_endpoint, connect):
    return connect(free_port_endpoint)


def say(other, seq, session=OTHER):
    other.put(KEYS.hypotheses, encode(replace(UPDATE, seq=seq, session=session)))


def looks(mine, meanwhile, seconds=0.5):
    """Look again and again, as the loop does."""
    end, k = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        meanwhile(k)
        mine.look(time.monotonic_ns())
        k += 1
        time.sleep(0.005)


def test_a_token_alone_makes_nobody_yield(service, other):
    token = other.liveliness().declare_token(KEYS.live("service", OLD_CLAIM))
    with Presence(service) as mine:
        mine.require()
        looks(mine, lambda _: None)
        # Neither does one update that comes again, nor a session without a token.
        looks(mine, lambda _: say(other, 7))
        looks(mine, lambda k: say(other, k, "c" * 16))
        assert mine.epoch == 0
    token.undeclare()


def test_a_service_yields_to_an_older_claim_that_speaks(service, other):
    with Presence(service) as mine:
        mine.require()
        token = other.liveliness().declare_token(KEYS.live("service", OLD_CLAIM))
        with pytest.raises(SceneTakenError, match="already served by 'x'"):
            looks(mine, lambda k: say(other, k), DEADLINE)
        token.undeclare()


def test_a_younger_claim_that_speaks_does_not_matter(service, other):
    with Presence(service) as mine:
        token = other.liveliness().declare_token(KEYS.live("service", f"x-{2**63:016x}-{OTHER}"))
        looks(mine, lambda k: say(other, k))
        assert mine.epoch == 0
        token.undeclare()
