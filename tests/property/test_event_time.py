"""Any interleaving of any batches: order, accounting and the watermark of event time; sequence numbers."""

import copy
import random
from collections import Counter, defaultdict

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from comotion.config import FusionConfig
from comotion.event_time.entries import Instants
from comotion.event_time.stats import Stats
from comotion.event_time.timeline import Timeline
from comotion.saving import plain, restored
from comotion_schemas.sequence import MAX_GAPS, MAX_JUMP, MAX_SESSIONS, SequenceCounter, Sighting

from .. import builders
from ..builders import MS, T0, S, fused, settled

CONFIG = FusionConfig(window=2.0)
LATENESS_NS = round(CONFIG.allowed_lateness * 1e9)


@st.composite
def batches(draw, most_rows=5):
    """A batch of one of three sources and sessions, from far behind to far ahead, of up to 5 instants."""
    offsets = draw(st.lists(st.integers(-3_000, 2_500), min_size=0, max_size=most_rows))
    stamp = None if offsets else draw(st.integers(-3_000, 2_500))
    source, session = draw(st.sampled_from("abc")), draw(st.sampled_from("012")) * 16
    return batch_of(source, session, draw(st.integers(0, 12)), offsets, stamp)


def batch_of(source, session, seq, offsets, stamp=None):
    """A batch with a row at each of `offsets`, ms; without any, at `stamp`."""
    stamp = T0 + (max(offsets) if offsets else stamp) * MS
    stamps = np.array([T0 + offset * MS for offset in offsets], np.int64) if offsets else None
    positions = np.zeros((len(offsets), 2))
    return builders.batch(source, seq, stamp, positions, session=session, stamps_ns=stamps)


def steps(batches):
    """What arrives before each advance, some of it refused by the caller, and ms since the last advance."""
    arrival = st.tuples(batches, st.sampled_from([None, None, None, "range"]))
    return st.lists(st.tuples(st.lists(arrival, max_size=6), st.integers(0, 400)), max_size=12)


class Run:
    """A timeline that is fed step by step."""

    def __init__(self, steps):
        self.steps = steps
        self.stats = Stats()
        self.timeline = Timeline(CONFIG, self.stats)
        self.now, self.followed = T0, False

    def __iter__(self):
        """(watermark before, what comes out) of each advance."""
        for arrivals, wait in self.steps:
            self.now += wait * MS
            for batch, refusal in arrivals:
                self.timeline.receive(batch, refusal)
            before = self.timeline.watermark_ns
            yield before, self.advance()

    def advance(self):
        """What comes out; all of it is fused."""
        events = fused(self.timeline, self.now)
        self.followed |= self.timeline.clock.shift_ns != 0
        assert self.stats.batches == settled(self.stats)
        return events

    def flush(self):
        """What comes out once another source has moved the watermark beyond everything that waits."""
        events = []
        for seq in range(3):
            self.now += 10_000 * MS
            self.timeline.receive(builders.batch("z", seq, self.now, np.zeros((0, 2)), session="f" * 16))
            events += self.advance()
        return events


@given(steps(batches()))
def test_whatever_comes_order_sessions_and_accounts_are_right(steps):
    run, released, ended = Run(steps), [], set()
    for before, events in run:
        watermark = run.timeline.watermark_ns
        assert before is None or watermark >= before
        assert watermark is None or watermark <= run.now
        instants = [event for event in events if isinstance(event, Instants)]
        order = [(i.stamp_ns, i.batch.source) for i in instants]
        assert order == sorted(order)
        for instant in instants:
            check_instant(run, instant, 0 if before is None else before - instant.stamp_ns)
        for event in events:
            if isinstance(event, Instants):
                assert event.session not in ended, "nothing of a session comes out after its end"
            else:
                ended.add(event)
        released += instants
    check_accounts(run, released + [event for event in run.flush() if isinstance(event, Instants)])


def check_instant(run, instant, behind):
    """Instants come out in stamp order, at most so far behind the watermark, with the rows of their batch."""
    assert behind <= LATENESS_NS
    assert instant.stamp_ns <= run.timeline.watermark_ns
    assert (np.diff(instant.stamps) >= 0).all()
    batch = instant.batch
    assert run.timeline.sessions[instant.session] == (batch.source, batch.session)
    moved = {0} if batch.stamps_ns is None else set((batch.stamps_ns[instant.rows] - instant.stamps).tolist())
    # The scene may have followed a clock that was set.
    assert len(moved) <= 1
    assert moved <= {0} or run.followed


def check_accounts(run, released):
    """Every batch is accounted once, every row comes out at most once, and what is missing is counted."""
    stats, batches = run.stats, {id(i.batch) for i in released}
    assert stats.batches == sum(len(arrivals) for arrivals, _ in run.steps) + 3
    assert len(batches) - stats.waiting <= stats.fused + stats.partly_late <= len(batches)
    assert stats.waiting == 0 or run.followed
    accounts = run.timeline.ledger.accounts.values()
    for name in ("batches", "fused", "partly_late", "late", "duplicates", "lost"):
        assert sum(getattr(account, name) for account in accounts) == getattr(stats, name)
    rows = {}
    for instant in released:
        rows.setdefault(id(instant.batch), []).extend(instant.rows.tolist())
    assert all(len(taken) == len(set(taken)) for taken in rows.values())
    arrived = {id(batch): batch for arrivals, _ in run.steps for batch, _ in arrivals}
    partly = sum(0 < len(taken) < len(arrived[key].ids) for key, taken in rows.items() if key in arrived)
    assert partly <= stats.partly_late + stats.waiting


def one_row(session, seq, at_ms):
    return batch_of("a", session * 16, seq, [at_ms])


# A decision on a clock that allows a rival to take over.
_TWO_DECISIONS = [
    ([(one_row("0", 0, 0), None)], 0),
    ([(one_row("1", 0, 143), None), (one_row("0", 1, -857), None)], 167),
    ([], 100),
    ([], 400),
]


@given(steps(batches()))
@example(_TWO_DECISIONS)
def test_a_second_advance_at_the_same_time_changes_nothing(steps):
    run = Run(steps)
    for _ in run:
        state, counters = run.timeline.state(), run.stats.counters()
        assert run.advance() == []
        assert (run.timeline.state(), run.stats.counters()) == (state, counters)


class Network:
    """Sources whose batches get lost, are repeated and overtake each other; knows what has been delivered."""

    def __init__(self, seed):
        self.chance = random.Random(seed)
        self.sent = dict.fromkeys("abc", 0)
        self.on_the_way = []

    def send(self, now_ms):
        """What arrives now: (source, seq, stamp in ms)."""
        for source in self.sent:
            for _ in range(self.chance.randrange(3)):
                batch = source, self.sent[source], now_ms - self.chance.randrange(300)
                self.sent[source] += 1
                self.on_the_way += self.chance.choice(([], [batch], [batch], [batch], [batch, batch]))
        self.chance.shuffle(self.on_the_way)
        count = self.chance.randrange(len(self.on_the_way) + 1)
        arrived, self.on_the_way = self.on_the_way[:count], self.on_the_way[count:]
        return arrived


@pytest.mark.parametrize("seed", range(5))
def test_accounts_are_those_of_an_accountant_over_restarts_of_the_service(seed):
    """The service is killed again and again, and goes on from what it has written some time before."""
    chance, network = random.Random(seed), Network(seed)
    service, now_ms = Timeline(CONFIG, Stats()), 0
    # By source: the numbers that this service has seen, and how many batches came; as of the state too.
    seen, came = {source: set() for source in "abc"}, dict.fromkeys("abc", 0)
    written = copy.deepcopy((service.state(), seen, came))
    restarts = 0
    for _ in range(300):
        now_ms += chance.randrange(100)
        for source, seq, stamp_ms in network.send(now_ms):
            service.receive(batch_of(source, "0" * 16, seq, [stamp_ms]))
            seen[source].add(seq)
            came[source] += 1
        fused(service, T0 + now_ms * MS)
        what = chance.random()
        if what < 0.1:
            written = copy.deepcopy((service.state(), seen, came))
        elif what < 0.15:
            restarts += 1
            state, seen, came = copy.deepcopy(written)
            service = Timeline(CONFIG, Stats())
            service.load(state)
    assert restarts > 3
    for source, sent in network.sent.items():
        key = source, "0" * 16
        service.ledger.claim(key, sent, 0)
        service.ledger.miss(2 * S)
        account = service.ledger.accounts[key]
        assert account.duplicates == came[source] - len(seen[source])
        assert settled(account) - account.duplicates + account.lost == sent
        assert account.lost >= sent - len(seen[source])
        assert account.fused > 0


A, B = "a" * 16, "b" * 16


def sight(numbers, counter=None):
    counter = counter or SequenceCounter()
    return [counter.sight("cam", A, seq) for seq in numbers]


streams = st.sampled_from([("cam", A), ("cam", B), ("arm", A)])


@given(st.lists(st.tuples(streams, st.integers(0, 12))), st.booleans(), st.integers(0, 20))
def test_every_number_of_a_session_is_new_once_and_what_is_missing_since_the_first_was_lost(
    numbers, from_zero, restart
):
    """The counter is saved and restored on the way; from zero on, what came before the first is lost too."""
    counter, first, seen, lost = SequenceCounter(from_zero=from_zero), {}, defaultdict(set), Counter()
    for k, (stream, seq) in enumerate(numbers):
        if k == restart:
            counter = restored(SequenceCounter, plain(counter))
        known = seen[stream]
        expected = "newest" if seq > max(known, default=-1) else "repeated" if seq in known else "overtaken"
        sighting = counter.sight(*stream, seq)
        known.add(seq)
        lost[stream] += sighting.lost
        begin = 0 if from_zero else first.setdefault(stream, seq)
        assert sighting.order == expected
        assert lost[stream] == len(set(range(begin, max(known))) - known)
        assert counter.newest(*stream) == max(known)


def test_a_jump_that_no_loss_explains_begins_anew_and_mutes_nothing():
    sightings = sight([0, 1, 2**64 - 1, 2, 3, 2**64 - 1, 4])
    assert [s.order for s in sightings] == ["newest"] * 7
    assert sum(s.lost for s in sightings) == 0
    assert sight([0, MAX_JUMP])[1].lost == MAX_JUMP - 1


def test_a_flood_of_sessions_leaves_those_seen_last():
    counter = SequenceCounter()
    sight([0], counter)
    counter.sight("idle", A, 0)
    for k in range(MAX_SESSIONS - 1):
        counter.sight("flood", f"{k:016x}", 0)
        sight([0], counter)
    assert sight([0], counter) == [Sighting(0, "repeated")]
    assert counter.sight("idle", A, 0) == Sighting(0, "newest")


def test_more_gaps_than_are_remembered_count_their_oldest_numbers_as_repeated():
    counter = SequenceCounter()
    sight(range(0, 2 * MAX_GAPS + 4, 2), counter)
    assert sight([1, 3, 5], counter)[0] == Sighting(0, "repeated")
    assert sight([2 * MAX_GAPS - 1], counter) == [Sighting(-1, "overtaken")]
