"""The fusion service as a process: what it publishes, answers, refuses and survives."""

import json
import signal
import time
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
import pytest
import zenoh

from comotion_schemas import HypothesisUpdate, Keys, ObservationBatch, Status, decode_as, encode
from comotion_schemas.transport import stream_publisher

from ... import builders
from ...builders import by_feature as labels
from ...builders import is_sorted_out
from ..conftest import Service
from ..waiting import DEADLINE, until

KEYS = Keys()


def batch(source: str = "bad", **fields: Any) -> ObservationBatch:
    return builders.batch(source, **({"stamp_ns": time.time_ns(), "positions": np.zeros((3, 3))} | fields))


HUGE = bytes(20_000_000)
# What only the service can see, and one of the codec's reasons: tests/unit/test_codec.py has all of those.
REFUSED: dict[str, Callable[[], bytes]] = {
    "malformed": lambda: b"\xc1 this is not msgpack",
    "non-finite": lambda: encode(batch())[:-4] + b"\x00\x00\xc0\x7f",
    "source-mismatch": lambda: encode(batch(source="somebody-else")),
    "future": lambda: encode(batch(stamp_ns=time.time_ns() + 10**10)),
    "space-mismatch": lambda: encode(batch(unit="px", seq=1)),
}


@pytest.fixture(scope="module")
def busy_endpoint(start_shared, shared_endpoint):
    """A service that is not changed by the tests that share it."""
    start_shared("serve", "--listen", shared_endpoint, "--set", "window=7")
    return shared_endpoint


@pytest.fixture
def busy(busy_endpoint, connect, listen, track):
    """The shared service with one source, sorted out, and what it published then."""
    track(busy_endpoint, "left")
    service = Service(None, busy_endpoint, connect(busy_endpoint), listen)
    service.update = service.updates.until(is_sorted_out)
    return service


def ask(session: zenoh.Session, selector: str) -> zenoh.Reply:
    replies = list(session.get(f"{KEYS.prefix}/query/{selector}", timeout=DEADLINE))
    assert len(replies) == 1
    return replies[0]


def content(reply: zenoh.Reply) -> bytes:
    assert reply.ok is not None, reply.err
    return reply.ok.payload.to_bytes()


def grown(after: Status, before: Status) -> dict[str, int]:
    growth = {reason: count - before.rejected.get(reason, 0) for reason, count in after.rejected.items()}
    return {reason: count for reason, count in growth.items() if count}


def test_a_malformed_batch_is_counted_with_its_reason_and_changes_nothing_else(busy):
    status_before = busy.statuses.until(lambda s: s.ages)
    publisher = stream_publisher(busy.session, KEYS, "obs", "bad")
    for make in REFUSED.values():
        publisher.put(make())
    status = busy.statuses.until(lambda s: sum(grown(s, status_before).values()) >= len(REFUSED))
    assert grown(status, status_before) == dict.fromkeys(REFUSED, 1)
    # Under load the transport may drop a message as large as this before it arrives.
    while "too-large" not in grown(status := busy.statuses.next(), status_before):
        publisher.put(HUGE)
    assert grown(status, status_before).keys() == {*REFUSED, "too-large"}
    assert status.state == "degraded"
    assert "obs/bad" in status.message
    for name in ("lost", "late", "duplicates", "tracks"):
        assert status.counters[name] == status_before.counters[name]
    busy.updates.drain()
    after = [busy.updates.next() for _ in range(8)]
    for update in after:
        assert labels(update) == labels(busy.update)
        assert [source.name for source in update.sources] == ["left"]
    # All are numbered, and published one after the other.
    assert [update.seq - after[0].seq for update in after] == list(range(8))
    assert {update.period_ns for update in after} == {100_000_000}
    assert (np.diff([update.published_ns for update in after]) > 0).all()


def test_every_queryable_answers_or_says_why_it_cannot(busy):
    snapshot = decode_as(HypothesisUpdate, content(ask(busy.session, "snapshot")))
    assert snapshot.session == busy.update.session
    assert snapshot.seq >= busy.update.seq
    status = decode_as(Status, content(ask(busy.session, "status")))
    assert (status.component, status.role, status.session) == ("fusion", "service", snapshot.session)
    assert json.loads(content(ask(busy.session, "config")))["window"] == 7.0
    schemas = json.loads(content(ask(busy.session, "schema")))
    assert "positions" in schemas["ObservationBatch"]["properties"]
    assert json.loads(content(ask(busy.session, "schema?message=Status"))) == schemas["Status"]
    for selector, words in (
        ("affinity?space=moon", "no space 'moon'; known: world"),
        ("schema?message=X", "no message 'X'"),
    ):
        assert words in ask(busy.session, selector).err.payload.to_string()


def affinities(busy):
    """Answer of the service about its only source, by feature id."""
    answer = msgpack.unpackb(content(ask(busy.session, "affinity?space=world")))
    tracks = np.frombuffer(answer["track_id"], "<u8")
    matrix = np.frombuffer(answer["matrix"], "<f4").reshape(len(tracks), len(tracks))
    assert (answer["schema"], [row["name"] for row in answer["sources"]]) == ("comotion.Affinity/1", ["left"])
    assert np.array_equal(matrix, matrix.T)
    return matrix[np.ix_(np.argsort(tracks), np.argsort(tracks))]


def test_affinities_are_those_of_the_last_update(busy):
    # The bodies have just begun to move: which update is certain of them is not known beforehand.
    for _ in range(100):
        matrix = affinities(busy)
        if matrix[:6, :6].min() > 0.9 and matrix[:6, 6:].max() < 0.5:
            break
        busy.updates.next()
    else:
        pytest.fail("no update was certain of the two bodies")
    # There is one space, so it need not be named.
    assert msgpack.unpackb(content(ask(busy.session, "affinity")))["space"] == "world"


def test_of_services_that_start_together_one_has_the_scene_until_it_stops(start, endpoint, session, listen):
    updates = listen(session, KEYS.hypotheses, "hypotheses")
    both = [start("serve", "--connect", endpoint, "--no-state", ready=False) for _ in range(2)]
    refused = both[0].wait_line(lambda line: line == "ready" or "already served" in line) != "ready"
    winner, loser = both[refused], both[not refused]
    winner.wait_ready()
    assert loser.wait() == 2
    assert "error: scene 'default' is already served by 'fusion'" in loser.lines
    assert len({updates.next().session for _ in range(5)}) == 1
    winner.signal(signal.SIGTERM)
    assert winner.wait() == 0
    # A slow machine says before that the methods are being prepared.
    assert winner.lines[-1] == "ready"
    until(lambda: not list(session.liveliness().get(KEYS.all_live("service"))))


def test_a_service_that_was_stopped_goes_on_or_yields_to_its_successor(
    start, endpoint, session, listen, tmp_path
):
    arguments = ("serve", "--connect", endpoint, "--state", tmp_path / "s")
    updates = listen(session, KEYS.hypotheses, "hypotheses")
    presence = session.liveliness().declare_subscriber(KEYS.all_live("service"), history=True)
    first = start(*arguments)
    assert presence.recv().kind == zenoh.SampleKind.PUT
    received = [updates.next()]
    first.signal(signal.SIGSTOP)
    assert presence.recv().kind == zenoh.SampleKind.DELETE
    last = [*received, *updates.drain()][-1]
    first.signal(signal.SIGCONT)
    before = updates.until(lambda u: u.seq > last.seq)
    assert before.session == last.session
    presence.undeclare()

    first.signal(signal.SIGSTOP)
    # The second waits until the token of the first has vanished.
    start(*arguments)
    after = updates.until(lambda u: u.session != before.session)
    first.signal(signal.SIGCONT)
    assert first.wait() == 2
    assert first.lines[-1] == "error: scene 'default' is already served by 'fusion'"
    assert {updates.next().session for _ in range(5)} | {u.session for u in updates.drain()} == {
        after.session
    }


def test_updates_come_from_the_start_and_a_late_joiner_gets_the_last_at_once(serve):
    # The next update is a minute away: whatever arrives before is the cached one.
    service = serve("--set", "period=60")
    update = service.updates.next(deadline=40)
    assert (update.seq, len(update.track_id)) == (0, 0)
    assert "none yet" in ask(service.session, "affinity").err.payload.to_string()


def test_a_recording_loses_nothing_in_a_running_service_nor_after_a_restart(serve, start, connect, tmp_path):
    options = ("--clock", "event", "--state", tmp_path / "s")
    service = serve(*options)

    def replay(rounds: int, session: zenoh.Session) -> None:
        for seq in range(30):
            payload = encode(batch("old", seq=seq, stamp_ns=10**18 + seq * 10**8))
            # A burst of which a loaded machine may drop nothing.
            block = zenoh.CongestionControl.BLOCK
            session.put(KEYS.stream("obs", "old"), payload, congestion_control=block)
        # Released, or held back by the watermark: never late, lost or repeated.
        status = service.statuses.until(
            lambda s: s.counters.get("fused", 0) + s.counters.get("waiting", 0) == 30 * rounds
        )
        assert {status.counters[name] for name in ("late", "partly_late", "lost", "duplicates")} == {0}
        assert status.rejected == {}

    replay(1, service.session)
    replay(2, service.session)
    assert service.process.interrupt() == 0
    service.statuses.drain()
    start("serve", "--listen", service.endpoint, *options)
    replay(3, connect(service.endpoint))


def test_an_overloaded_service_leaves_out_work_and_no_observation(serve, connect, track):
    # No update of some features takes less than 5 ms.
    service = serve("--set", "period=0.005")
    track(service.endpoint, "left")
    status = service.statuses.until(lambda s: "left out are joints" in s.message)
    assert status.state == "degraded"
    later = service.statuses.until(lambda s: s.counters["shed"] > status.counters["shed"])
    assert later.counters["fused"] > status.counters["fused"]
    assert later.counters["late"] == later.counters["lost"] == later.counters["overflow"] == 0
