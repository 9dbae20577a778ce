"""Every rule of the protocol's section "Time", on simulated time."""

import numpy as np
import pytest

from comotion.config import FusionConfig
from comotion.event_time import timeline
from comotion.event_time.entries import Instants
from comotion.event_time.stats import Stats
from comotion.event_time.timeline import Timeline

from .. import builders
from ..builders import MS, T0, S, fused, settled


def batch(source, seq, stamp_ns, ids=(1,), **fields):
    positions = np.zeros((len(ids), 2))
    return builders.batch(source, seq, stamp_ns, positions, ids=np.array(ids, np.uint64), **fields)


class Clockwork:
    """A timeline that is fed and read in one line."""

    def __init__(self, **config):
        self.stats = Stats()
        self.timeline = Timeline(FusionConfig(**config), self.stats)

    def feed(self, *batches):
        for b in batches:
            self.timeline.receive(b)

    def at(self, now_ns):
        """(stamp - T0 in ms, source) of the instants that come out of an advance."""
        return [
            ((i.stamp_ns - T0) // MS, i.batch.source) for i in self.advance(now_ns) if isinstance(i, Instants)
        ]

    def advance(self, now_ns):
        """What comes out of an advance; all of it is fused."""
        events = fused(self.timeline, T0 + now_ns)
        assert self.stats.batches == settled(self.stats)
        return events

    @property
    def watermark(self):
        return (self.timeline.watermark_ns - T0) // MS


@pytest.fixture
def clock():
    return Clockwork()


def test_watermark_is_the_smallest_newest_stamp_of_live_sources_and_what_is_newer_waits(clock):
    clock.feed(batch("fast", 0, T0 + 400 * MS), batch("slow", 0, T0 + 300 * MS))
    assert clock.at(410 * MS) == [(300, "slow")]
    assert clock.watermark == 300
    clock.feed(batch("slow", 1, T0 + 420 * MS))
    assert clock.at(430 * MS) == [(400, "fast")]


def test_watermark_lags_at_most_max_lag_behind_now(clock):
    clock.feed(batch("slow", 0, T0))
    clock.at(0)
    clock.feed(batch("fast", 0, T0 + 900 * MS))
    clock.at(900 * MS)
    assert clock.watermark == 400


def test_a_stalled_source_is_left_out_and_comes_back(clock):
    clock.feed(batch("stalls", 0, T0), batch("runs", 0, T0))
    clock.at(0)
    clock.feed(batch("runs", 1, T0 + 2_000 * MS))
    clock.at(2_000 * MS)
    assert clock.watermark == 2_000
    clock.feed(batch("stalls", 1, T0 + 2_100 * MS), batch("runs", 2, T0 + 2_200 * MS))
    assert clock.at(2_200 * MS) == [(2_100, "stalls")]
    assert clock.watermark == 2_100


@pytest.mark.parametrize(("stamp", "out", "counted"), [(300, [(300, "b")], (1, 0)), (299, [], (0, 1))])
def test_late_data_is_reordered_or_beyond_the_allowed_lateness_dropped(clock, stamp, out, counted):
    clock.feed(batch("a", 0, T0 + 500 * MS))
    clock.at(500 * MS)
    clock.feed(batch("b", 0, T0 + stamp * MS))
    assert clock.at(510 * MS) == out
    assert (clock.stats.reordered, clock.stats.late) == counted


def test_lateness_is_judged_row_by_row(clock):
    clock.feed(batch("a", 0, T0 + 500 * MS))
    clock.at(500 * MS)
    stamps = np.array([T0 + 100 * MS, T0 + 400 * MS, T0 + 600 * MS])
    clock.feed(batch("b", 0, T0 + 600 * MS, ids=(1, 1, 1), stamps_ns=stamps), batch("a", 1, T0 + 600 * MS))
    assert clock.at(600 * MS) == [(400, "b"), (600, "a"), (600, "b")]
    assert (clock.stats.reordered, clock.stats.partly_late, clock.stats.late) == (1, 1, 0)


def test_a_move_that_the_table_lacks_is_counted_and_costs_the_batch(clock):
    clock.feed(batch("a", 0, T0))
    (entry,) = clock.timeline._inbox
    for faults in (1, 2):
        clock.timeline._move(entry, "fused")
        assert (clock.stats.faults, clock.stats.rejected, clock.stats.waiting) == (faults, {"defect": 1}, 0)


def test_the_first_of_all_waits_when_its_clock_is_ahead_until_it_is_clear_who_is_wrong(clock):
    clock.feed(batch("wrong", 0, T0 + 1_001 * MS), batch("right", 0, T0))
    assert clock.at(0) == [(0, "right")]
    assert clock.stats.waiting == 1
    clock.feed(batch("right", 1, T0 + 250 * MS))
    clock.at(250 * MS)
    assert clock.stats.rejected == {"future": 1}


def test_a_clock_far_behind_is_rejected_while_nothing_is_live(clock):
    clock.feed(batch("old", 0, T0 - 20 * S))
    assert clock.at(0) == []
    assert clock.stats.rejected == {"past": 1}


def test_what_a_source_says_it_has_sent_and_never_came_is_lost(clock):
    clock.feed(batch("a", 0, T0))
    claim(clock, ("a", "a" * 16), 4)
    claim(clock, ("b", "b" * 16), 2)
    assert clock.stats.lost == 5
    clock.feed(batch("a", 3, T0 + MS), batch("a", 5, T0 + 2 * MS))
    assert clock.stats.lost == 5
    claim(clock, ("a", "a" * 16), 2**64 - 1)
    assert clock.stats.lost == 5


def claim(clock, key, count):
    clock.timeline.ledger.claim(key, count, 0)
    clock.timeline.ledger.miss(2 * S)


def test_a_claim_counts_once_the_batches_should_be_here(clock):
    ledger, key = clock.timeline.ledger, ("cam", "a" * 16)
    ledger.claim(key, 5, 0)
    ledger.claim(key, 9, S)
    ledger.miss(2 * S - 1)
    assert clock.stats.lost == 0
    ledger.miss(2 * S)
    assert clock.stats.lost == 5
    # What a session says last counts, though an earlier claim was pending.
    ledger.miss(9 * S)
    assert clock.stats.lost == 9


def restarted(clock):
    state, clock = clock.timeline.state(), Clockwork()
    clock.timeline.load(state)
    return clock


def test_what_the_newest_sessions_have_sent_is_unknown_until_they_speak(clock):
    for session in ("b", "a"):
        clock.feed(batch("cam", 0, T0, session=session * 16))
    clock.feed(batch("gone", 0, T0))
    clock = restarted(clock)
    assert clock.timeline.ledger.unknown == {("cam", "a" * 16), ("gone", "a" * 16)}
    clock.timeline.ledger.claim(("cam", "a" * 16), 1, 0)
    clock.feed(batch("gone", 1, T0 + MS))
    assert not clock.timeline.ledger.unknown


def test_a_session_that_has_ended_unheard_stays_unknown_when_another_follows_it(clock):
    clock.feed(batch("cam", 0, T0))
    clock = restarted(clock)
    clock.feed(batch("cam", 0, T0 + S, session="b" * 16))
    assert ("cam", "a" * 16) in restarted(clock).timeline.ledger.unknown


def test_what_was_claimed_right_before_the_end_of_the_service_counts(clock):
    clock.feed(batch("cam", 0, T0))
    clock.timeline.ledger.claim(("cam", "a" * 16), 4, 0)
    clock.feed(batch("cam", 0, T0 + S, session="b" * 16))
    clock = restarted(clock)
    clock.timeline.ledger.miss(0)
    # The first one waited for the watermark, and did not survive.
    assert clock.timeline.ledger.accounts["cam", "a" * 16].lost == 4


def test_a_second_process_of_a_name_is_refused_while_the_first_one_sends(clock):
    for k in range(40):
        clock.feed(batch("a", k, T0 + k * 30 * MS))
        if k >= 5:
            clock.feed(batch("a", k - 5, T0 + k * 30 * MS, session="b" * 16))
        clock.at(k * 30 * MS)
    assert {session for _, session in clock.timeline.sessions.values()} == {"a" * 16}
    assert list(clock.timeline.troubles.lately()["duplicate-name"]) == ["a"]
    assert 25 <= clock.stats.rejected["duplicate-name"] <= 33
    # The first leaves: the second gets the name, and what it sent since then.
    for k in range(40, 60):
        clock.feed(batch("a", k - 5, T0 + k * 30 * MS, session="b" * 16))
        clock.at(k * 30 * MS)
    accounts = clock.timeline.ledger.accounts
    assert accounts["a", "b" * 16].rejected["duplicate-name"] <= 35
    assert accounts["a", "b" * 16].fused >= 20
    # It comes back and the second leaves: it has the name again, though its session was over.
    for k in range(60, 80):
        clock.feed(batch("a", k, T0 + k * 30 * MS))
        clock.at(k * 30 * MS)
    assert clock.timeline.sources["a"].session == "a" * 16
    assert clock.stats.late == 0


def test_a_flood_of_sessions_is_refused_and_the_first_one_goes_on(clock):
    for k in range(6_000):
        clock.feed(batch("a", 0, T0, session=f"{k:016x}"))
    assert [clock.timeline.sessions[one.session] for one in clock.advance(0)] == [("a", f"{0:016x}")]
    clock.feed(batch("a", 1, T0 + MS, session=f"{0:016x}"))
    assert clock.at(MS) == [(1, "a")]
    clock.feed(batch("a", 2, T0 + 1_500 * MS, session=f"{0:016x}"))
    clock.at(1_500 * MS)
    assert clock.stats.rejected["duplicate-name"] + clock.stats.rejected["limit"] == 5_999
    assert clock.stats.waiting == 0


def test_one_source_too_many_is_refused_while_all_others_send(clock, monkeypatch):
    monkeypatch.setattr(timeline, "MAX_SOURCES", 3)
    clock.feed(*(batch(f"s{k}", 0, T0) for k in range(5)))
    assert len(clock.at(0)) == 3
    assert clock.stats.rejected == {"limit": 2}
    clock.feed(*(batch(name, 1, T0 + 2 * S) for name in ("s1", "s2", "s4")))
    assert {row[1] for row in clock.at(2 * S)} == {"s1", "s2", "s4"}


def test_a_batch_of_too_many_instants_is_refused(clock):
    stamps = T0 + np.arange(100_000)
    clock.feed(batch("a", 0, int(stamps[-1]), ids=np.arange(100_000), stamps_ns=stamps))
    assert clock.at(MS) == []
    assert clock.stats.rejected == {"limit": 1}


def test_a_slow_source_gives_its_trajectories_three_periods():
    clock = Clockwork()
    for k in range(5):
        clock.feed(batch("slow", k, T0 + k * 400 * MS))
    clock.at(1_600 * MS)
    clock.feed(batch("quick", 0, T0 + 1_600 * MS), batch("quick", 1, T0 + 1_610 * MS))
    clock.at(1_610 * MS)
    timeouts = {name: clock.timeline.track_timeout_ns(n) for n, (name, _) in clock.timeline.sessions.items()}
    assert timeouts == {"slow": 1_200 * MS, "quick": 500 * MS}


def test_more_than_a_source_may_let_wait_is_refused(monkeypatch):
    monkeypatch.setattr(timeline, "_MAX_BATCHES", 2)
    clock = Clockwork()
    clock.feed(*(batch("a", k, T0 + (10 + k) * MS) for k in range(3)), batch("b", 0, T0 + 10 * MS))
    assert clock.stats.rejected == {"limit": 1}
    assert len(clock.at(15 * MS)) == 2
    clock.feed(batch("a", 3, T0 + 30 * MS), batch("b", 1, T0 + 30 * MS))
    assert clock.at(30 * MS) == [(11, "a"), (30, "a"), (30, "b")]


def test_large_batches_that_wait_are_bounded_by_their_bytes(monkeypatch):
    monkeypatch.setattr(timeline, "_MAX_BYTES", (1_000_000, 1_500_000))
    clock = Clockwork()
    many = range(20_000)  # 0.3 MB
    clock.feed(*(batch("a", k, T0 + k * MS, ids=many) for k in range(4)))
    assert clock.stats.rejected == {"limit": 1}
    clock.feed(*(batch("b", k, T0 + k * MS, ids=many) for k in range(4)))
    assert clock.stats.rejected == {"limit": 3}
    clock.at(S)
    clock.feed(*(batch(name, 4 + k, T0 + S, ids=many) for k, name in enumerate("baaa")))
    assert clock.stats.rejected == {"limit": 3}, "what came out waits no more"
