"""The service's subscriptions to batches and Statuses, against a publisher in the same process."""

from itertools import count

import zenoh

from comotion.config import FusionConfig
from comotion.event_time.stats import Stats
from comotion.event_time.timeline import Timeline
from comotion.runtime import intake, queues
from comotion.runtime.intake import Intake, Statuses, Tokens
from comotion.runtime.queues import OTHERS
from comotion_schemas import Keys, encode
from comotion_schemas.transport import stream_publisher

from .. import builders
from ..builders import batch
from .waiting import until

KEYS = Keys()


def payload(source, seq):
    return encode(batch(source, seq, seq))


class Reader:
    """Polls an intake until enough has come; the event to wait for is what comes in."""

    def __init__(self, session):
        timeline = Timeline(FusionConfig(), Stats())
        self.stats, self.ledger = timeline.stats, timeline.ledger
        self.intake = Intake(session, KEYS, timeline)
        self.got: list[tuple[str, int]] = []

    def poll(self, now_ns=0):
        self.got += [(batch.source, batch.seq) for batch in self.intake.receive(now_ns)]

    def until(self, fulfilled, meanwhile=lambda: None):
        def poll():
            meanwhile()
            self.poll()

        until(fulfilled, poll)


def blocking_publishers(session, names):
    """Publishers by name that wait; sources drop what is congested, as on a loaded machine."""
    block = zenoh.CongestionControl.BLOCK
    return {
        name: session.declare_publisher(KEYS.stream("obs", name), congestion_control=block) for name in names
    }


def test_a_source_is_known_by_its_batches_or_by_its_status(router, session):
    reader = Reader(router)
    seconds = count(step=1_000_000_000)
    held = [session.liveliness().declare_token(KEYS.live("source", name)) for name in ("a", "b", "c")]
    session.put(KEYS.stream("obs", "a"), payload("a", 0))
    session.put(KEYS.stream("status", "b"), encode(status("b")))

    def step():
        reader.poll(next(seconds))
        reader.intake.tokens.heard.update(status.component for status, _ in reader.intake.statuses.read())

    until(lambda: reader.intake.tokens.present.keys() == {"a", "b"}, step)
    for token in held:
        token.undeclare()
    until(lambda: not reader.intake.tokens.present, step)


def test_no_more_names_are_remembered_than_there_may_be_sources(router, session, monkeypatch):
    monkeypatch.setattr(intake, "MAX_SOURCES", 3)
    names = {f"s-{k}" for k in range(6)}
    tokens, seconds = Tokens(router, KEYS), count(step=1_000_000_000)
    held = {name: session.liveliness().declare_token(KEYS.live("source", name)) for name in names}

    def look():
        tokens.heard |= names
        tokens.look(next(seconds))

    until(lambda: len(tokens.present) == 3, look)
    gone = min(tokens.present)
    held.pop(gone).undeclare()
    # One of the others, which were asked for in vain, takes its place.
    until(lambda: gone not in tokens.present and len(tokens.present) >= 3, look)
    assert len(tokens.present) == 3


def test_a_flood_of_one_source_does_not_displace_another(router, session):
    reader = Reader(router)
    loud, quiet = (stream_publisher(session, KEYS, "obs", name) for name in ("loud", "quiet"))
    loud.put(payload("loud", 0))
    quiet.put(payload("quiet", 0))
    reader.until(lambda: len(reader.got) == 2)
    for seq in range(1, 5):
        quiet.put(payload("quiet", seq))
    for seq in range(1, 3000):
        loud.put(payload("loud", seq))
    # The flood may drop anything of its own.
    last = ("loud", 3000)
    reader.until(lambda: last in reader.got, meanwhile=lambda: loud.put(payload(*last)))
    assert [seq for source, seq in reader.got if source == "quiet"] == list(range(5))


def test_what_comes_while_nobody_reads_is_kept_up_to_a_bound_in_bytes(router, session):
    reader = Reader(router)
    fast, large = blocking_publishers(session, ("fast", "large")).values()
    for name, publisher in (("fast", fast), ("large", large)):
        publisher.put(payload(name, 0))
    reader.until(lambda: len(reader.got) == 2)

    def awaited(name, newest, count):
        waiting = reader.intake.of[name].waiting
        until(lambda: waiting and waiting[-1][1] == newest and len(waiting) == count)

    for seq in range(1, 301):
        fast.put(payload("fast", seq))
    awaited("fast", payload("fast", 300), 300)
    for k in range(12):
        large.put(bytes([k]) * 5_000_000)
    awaited("large", bytes([11]) * 5_000_000, 6)
    reader.until(lambda: reader.stats.rejected == {"malformed": 6})
    assert [seq for source, seq in reader.got if source == "fast"] == list(range(301))
    assert (reader.stats.overflow, reader.stats.lost) == (6, 0)


def test_each_source_has_a_batch_read_however_little_time_there_is(router, session):
    reader = Reader(router)
    publishers = blocking_publishers(session, ("a", "b"))
    for seq in range(6):
        for name, publisher in publishers.items():
            publisher.put(payload(name, seq))
        reader.until(lambda: len(reader.got) >= 2 or seq > 0)  # noqa: B023
    left = 2 * 6 - len(reader.got)
    until(lambda: waiting(reader) == left)
    before = len(reader.got)
    reader.got += [(batch.source, batch.seq) for batch in reader.intake.receive(0, budget_ns=0)]
    assert sorted(source for source, _ in reader.got[before:]) == ["a", "b"]
    reader.until(lambda: len(reader.got) == 12)


def waiting(reader):
    """Payloads that have come and are not read."""
    return sum(len(queue.waiting) for queue in list(reader.intake.of.values()))


def test_what_has_no_valid_name_is_refused_and_displaces_nobody(router, session):
    reader = Reader(router)
    for k in range(2000):
        session.put(f"{KEYS.streams('obs')[:-1]}No-{k}", payload("a", 0))
    session.put(KEYS.stream("obs", "a"), payload("a", 0))
    reader.until(lambda: reader.got == [("a", 0)] and waiting(reader) == 0)
    stats = reader.stats
    assert stats.batches == stats.rejected["source-mismatch"] + stats.overflow > 900
    assert list(reader.intake.of) == [OTHERS, "a"]


def test_of_a_storm_of_names_some_are_read_with_those_known_and_those_too_many_refused_and_named(
    router, session, monkeypatch
):
    monkeypatch.setattr(queues, "MAX_SOURCES", 20)
    reader = Reader(router)
    session.put(KEYS.stream("obs", "known"), payload("known", 0))
    reader.until(lambda: len(reader.got) == 1)
    names = [f"new-{k:02}" for k in range(40)]
    for name in names:
        session.put(KEYS.stream("obs", name), payload(name, 0))
    session.put(KEYS.stream("obs", "known"), payload("known", 1))
    until(lambda: waiting(reader) == 41)
    reader.poll()
    assert reader.got[1:] == [("known", 1), *((name, 0) for name in names[:16])]
    assert reader.stats.rejected == {"limit": 21}
    assert reader.ledger.troubles.sources("limit") == set(names[19:])
    reader.until(lambda: len(reader.got) == 2 + 19)


def status(component, sent=0, **fields):
    return builders.status(component, **({"role": "source", "counters": {"sent": sent}} | fields))


class StatusReader:
    """Reads Statuses until enough has come."""

    def __init__(self, router):
        self.statuses = Statuses(router, KEYS)
        self.got: list[tuple[str, int]] = []

    def until(self, fulfilled):
        until(fulfilled, self._read)

    def _read(self):
        statuses = self.statuses.read()
        assert len(statuses) <= 16
        self.got += [(status.component, status.counters["sent"]) for status, _ in statuses]


def put(session, name, *args, **fields):
    """Publish a Status of a component under this name, its own unless told."""
    session.put(KEYS.stream("status", name), encode(status(*(args or (name,)), **fields)))


def test_of_a_storm_the_newest_is_read_and_others_with_it(router, session):
    reader = StatusReader(router)
    for k in range(3000):
        put(session, "loud", "loud", k)
    put(session, "quiet", "quiet", 7)
    reader.until(lambda: {("loud", 2999), ("quiet", 7)} <= set(reader.got))
    # Twice a second at most: what the storm took is some of 3000.
    assert sum(name == "loud" for name, _ in reader.got) < 100
    assert reader.statuses.refused == 0


def test_a_status_about_another_component_is_refused_and_counted(router, session):
    reader = StatusReader(router)
    put(session, "liar", "cam", 2**31)
    put(session, "cam", "cam", 5)
    reader.until(lambda: reader.statuses.refused == 1 and bool(reader.got))
    assert reader.got == [("cam", 5)]


def test_what_is_no_status_or_too_large_and_names_beyond_the_bound_are_refused(router, session, monkeypatch):
    monkeypatch.setattr(intake, "MAX_SOURCES", 100)
    reader = StatusReader(router)
    put(session, "large", rates={f"stream-{k}": 1.0 for k in range(30_000)})
    session.put(KEYS.stream("status", "cam"), b"\x00")
    reader.until(lambda: reader.statuses.refused == 2)
    for k in range(300):
        put(session, f"cam-{k}")
    reader.until(lambda: len(reader.got) + reader.statuses.refused == 302)
    assert len(reader.got) >= 100
