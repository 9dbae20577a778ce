"""Subscriptions over real Zenoh on a loopback port."""

import asyncio
import subprocess
import sys
import threading

import pytest
import zenoh

from comotion_clients.subscribe import Subscription, subscribe
from comotion_schemas import HypothesisUpdate, ObservationBatch, Status, TruthBatch, encode
from comotion_schemas.transport import declare_publisher

from .. import builders
from ..builders import SESSION, batch, status
from .conftest import KEYS
from .waiting import DEADLINE


def update(seq: int, scene: str = "default", *, session: str = SESSION) -> HypothesisUpdate:
    return builders.update(scene=scene, seq=seq, stamp_ns=seq, session=session)


def test_a_reader_that_is_too_slow_loses_the_oldest(session, endpoint):
    publisher = declare_publisher(session, KEYS.hypotheses, "hypotheses")
    other = Subscription(session, HypothesisUpdate, timeout=DEADLINE)
    with other, Subscription(session, HypothesisUpdate, capacity=2, timeout=DEADLINE) as slow:
        for seq in range(10):
            publisher.put(encode(update(seq)))
        assert [next(other).seq for _ in range(10)] == list(range(10))
        while slow.counters.received < 10:
            pass
        assert slow.dropped == 8
        assert [message.seq for _, message in slow.drain()] == [8, 9]


def test_invalid_payloads_are_counted_by_reason_and_skipped(session, endpoint):
    publisher = declare_publisher(session, KEYS.hypotheses, "hypotheses")
    with Subscription(session, HypothesisUpdate, timeout=DEADLINE) as updates:
        wrong = b"\xc1 not msgpack", encode(batch("a", 0)), encode(update(0, "elsewhere"))
        for payload in (*wrong, encode(update(1))):
            publisher.put(payload)
        assert next(updates).seq == 1
        assert updates.counters.invalid == {"malformed": 1, "schema": 1, "source-mismatch": 1}


def test_observations_status_and_truth(session, endpoint):
    truths = declare_publisher(session, KEYS.stream("truth", "cam"), "truth")
    for feature in range(1500):
        truths.put(encode(TruthBatch(source="cam", session=SESSION, ids=[feature], objects=[1], names={})))
    with subscribe("default", endpoint, message=TruthBatch, timeout=DEADLINE) as truth:
        assert [int(next(truth).ids[0]) for _ in range(1500)] == list(range(1500))
    observations = declare_publisher(session, KEYS.stream("obs", "cam"), "obs")
    with Subscription(session, ObservationBatch, timeout=DEADLINE) as batches:
        observations.put(encode(batch("cam", 0)))
        assert next(batches).source == "cam"
    publisher = declare_publisher(session, KEYS.stream("status", "cam"), "status")
    publisher.put(encode(status("cam", "source")))
    with subscribe("default", endpoint, message=Status, timeout=DEADLINE) as statuses:
        assert next(statuses).component == "cam"


def test_a_storm_of_statuses_of_one_component_displaces_no_other(session, endpoint):
    quiet = declare_publisher(session, KEYS.stream("status", "quiet"), "status")
    quiet.put(encode(status("quiet", "source")))
    with subscribe("default", endpoint, message=Status, timeout=DEADLINE) as statuses:
        assert next(statuses).component == "quiet"
        blocking = zenoh.CongestionControl.BLOCK
        for component in ["loud"] * 500 + ["last"]:
            told = encode(status(component, "source"))
            session.put(KEYS.stream("status", component), told, congestion_control=blocking)
        while (latest := next(statuses)).component != "last":
            assert latest.component == "loud"
        assert statuses.counters.received < 100
        assert statuses.counters.received + statuses.counters.stale == 502


def test_asyncio(session, endpoint):
    publisher = declare_publisher(session, KEYS.hypotheses, "hypotheses")
    publisher.put(encode(update(0)))

    async def read() -> list[int]:
        numbers = []
        async with subscribe("default", endpoint, timeout=DEADLINE) as updates:
            async for message in updates:
                numbers.append(message.seq)
                if len(numbers) == 3:
                    return numbers
                publisher.put(encode(update(len(numbers))))
        return numbers

    assert asyncio.run(read()) == [0, 1, 2]


def test_closing_ends_a_loop_that_waits(session):
    updates = Subscription(session, HypothesisUpdate)
    threading.Thread(target=updates.close).start()
    assert list(updates) == []
    updates.close()


def test_a_program_that_closes_nothing_ends_well(session, endpoint):
    code = f"from comotion_clients import subscribe as s; a = s.subscribe('s', {endpoint!r}); a.__enter__()"
    subprocess.run([sys.executable, "-c", code], timeout=DEADLINE, check=True)


def test_silence_and_no_router_are_timeouts_and_wrong_names_and_endpoints_are_refused_at_once(endpoint):
    with subscribe("default", endpoint, timeout=0.5) as updates, pytest.raises(TimeoutError):
        next(updates)
    with pytest.raises(TimeoutError, match=r"no router answers at tcp/127\.0\.0\.1:1"):
        subscribe("scene", "tcp/127.0.0.1:1", timeout=0.2).__enter__()
    with pytest.raises(ValueError, match="scene"):
        subscribe("No Scene")
    with pytest.raises(ValueError, match="cannot open a session at nonsense"):
        subscribe("scene", "nonsense").__enter__()
