"""Every rule of the protocol's section "Time", on simulated time."""

import numpy as np
import pytest

from comotion.config import FusionConfig
from comotion.event_time.stats import Stats
from comotion.event_time.timeline import Timeline
from comotion_schemas import ObservationBatch

MS = 1_000_000
S = 1_000 * MS
T0 = 1_700_000_000 * S


def batch(source, seq, stamp_ns, ids=(1,), session="a" * 16, stamps_ns=None, **fields):
    return ObservationBatch(
        source=source,
        session=session,
        seq=seq,
        space="world",
        unit="m",
        dim=2,
        stamp_ns=stamp_ns,
        ids=np.array(ids, np.uint64),
        positions=np.zeros((len(ids), 2)),
        stamps_ns=stamps_ns,
        **fields,
    )


class Clockwork:
    """A timeline that is fed and read in one line."""

    def __init__(self, **config):
        self.stats = Stats()
        self.timeline = Timeline(FusionConfig(**config), self.stats)

    def feed(self, *batches):
        for b in batches:
            if self.timeline.is_new(b):
                self.timeline.add(b)

    def at(self, now_ns):
        """(stamp - T0 in ms, source, in_order) of what is released, after an advance."""
        return [
            ((i.stamp_ns - T0) // MS, i.batch.source, i.in_order) for i in self.timeline.advance(T0 + now_ns)
        ]

    @property
    def watermark(self):
        return (self.timeline.watermark_ns - T0) // MS


@pytest.fixture
def clock():
    return Clockwork()


def test_watermark_is_the_smallest_newest_stamp_of_live_sources(clock):
    clock.feed(batch("fast", 0, T0 + 400 * MS), batch("slow", 0, T0 + 300 * MS))
    assert clock.at(410 * MS) == [(300, "slow", True)]
    assert clock.watermark == 300


def test_what_is_newer_than_the_watermark_waits_for_the_next_update(clock):
    clock.feed(batch("fast", 0, T0 + 400 * MS), batch("slow", 0, T0 + 300 * MS))
    clock.at(410 * MS)
    clock.feed(batch("slow", 1, T0 + 420 * MS))
    assert clock.at(430 * MS) == [(400, "fast", True)]


def test_watermark_lags_at_most_max_lag_behind_now(clock):
    clock.feed(batch("slow", 0, T0))
    clock.at(0)
    clock.feed(batch("fast", 0, T0 + 900 * MS))
    clock.at(900 * MS)
    assert clock.watermark == 400


def test_watermark_never_runs_ahead_of_now(clock):
    clock.feed(batch("ahead", 0, T0 + 700 * MS))
    assert clock.at(0) == []
    assert clock.watermark == 0
    assert clock.at(700 * MS) == [(700, "ahead", True)]


def test_watermark_never_runs_backwards_even_when_the_clock_is_set_back(clock):
    clock.feed(batch("a", 0, T0 + 500 * MS))
    clock.at(500 * MS)
    clock.feed(batch("b", 0, T0 + 450 * MS))
    clock.at(100 * MS)
    assert clock.watermark == 500


def test_without_a_live_source_the_watermark_stands_still(clock):
    clock.feed(batch("a", 0, T0))
    clock.at(0)
    clock.at(1_000 * MS)
    assert clock.watermark == 500, "live until source_timeout: max_lag pulls"
    clock.at(5_000 * MS)
    assert clock.watermark == 500, "dead: nothing pulls"


def test_nothing_ever_seen_leaves_the_watermark_unset(clock):
    assert clock.at(1_000 * MS) == []
    assert clock.timeline.watermark_ns is None


def test_a_stalled_source_is_left_out_and_comes_back(clock):
    clock.feed(batch("stalls", 0, T0), batch("runs", 0, T0))
    clock.at(0)
    clock.feed(batch("runs", 1, T0 + 2_000 * MS))
    clock.at(2_000 * MS)
    assert clock.watermark == 2_000
    assert not clock.timeline.is_live("stalls", T0 + 2_000 * MS)
    clock.feed(batch("stalls", 1, T0 + 2_100 * MS), batch("runs", 2, T0 + 2_200 * MS))
    assert clock.at(2_200 * MS) == [(2_100, "stalls", True)]
    assert clock.watermark == 2_100


def test_release_is_in_stamp_order_with_ties_by_source_name(clock):
    clock.feed(
        batch("b", 0, T0 + 10 * MS),
        batch("c", 0, T0 + 5 * MS),
        batch("a", 0, T0 + 10 * MS),
        batch("c", 1, T0 + 10 * MS),
    )
    assert clock.at(20 * MS) == [(5, "c", True), (10, "a", True), (10, "b", True), (10, "c", True)]


def test_slightly_late_data_is_inserted_and_counted_reordered(clock):
    clock.feed(batch("a", 0, T0 + 500 * MS))
    clock.at(500 * MS)
    clock.feed(batch("b", 0, T0 + 300 * MS))
    assert clock.at(510 * MS) == [(300, "b", False)]
    assert (clock.stats.reordered, clock.stats.late) == (1, 0)


def test_data_older_than_the_allowed_lateness_is_dropped_and_counted_late(clock):
    clock.feed(batch("a", 0, T0 + 500 * MS))
    clock.at(500 * MS)
    clock.feed(batch("b", 0, T0 + 299 * MS))
    assert clock.at(510 * MS) == []
    assert (clock.stats.reordered, clock.stats.late) == (0, 1)


def test_lateness_is_judged_row_by_row(clock):
    clock.feed(batch("a", 0, T0 + 500 * MS))
    clock.at(500 * MS)
    stamps = np.array([T0 + 100 * MS, T0 + 400 * MS, T0 + 600 * MS])
    clock.feed(batch("b", 0, T0 + 600 * MS, ids=(1, 1, 1), stamps_ns=stamps), batch("a", 1, T0 + 600 * MS))
    assert clock.at(600 * MS) == [(400, "b", False), (600, "a", True), (600, "b", True)]
    assert (clock.stats.reordered, clock.stats.late) == (1, 1)


def test_a_wrong_clock_far_ahead_is_rejected_and_moves_nothing(clock):
    clock.feed(batch("wrong", 0, T0 + 1_001 * MS), batch("right", 0, T0))
    assert clock.at(0) == [(0, "right", True)]
    assert clock.stats.rejected == {"future": 1}
    assert "wrong" not in clock.timeline.sources
    clock.feed(batch("right", 1, T0 + 100 * MS))
    clock.at(100 * MS)
    assert clock.watermark == 100


def test_a_rejected_future_batch_does_not_start_a_session(clock):
    clock.feed(batch("s", 0, T0))
    clock.at(0)
    clock.feed(batch("s", 0, T0 + 5 * S, session="b" * 16))
    clock.at(10 * MS)
    clock.feed(batch("s", 1, T0 + 20 * MS))
    assert clock.at(20 * MS) == [(20, "s", True)]


def test_a_clock_far_behind_is_rejected_while_nothing_is_live(clock):
    clock.feed(batch("old", 0, T0 - 20 * S))
    assert clock.at(0) == []
    assert clock.stats.rejected == {"past": 1}


def test_sequence_gaps_are_counted_as_loss(clock):
    clock.feed(batch("a", 7, T0), batch("a", 8, T0 + MS), batch("a", 11, T0 + 2 * MS))
    assert clock.stats.lost == 2


def test_a_repeated_batch_is_a_duplicate_and_is_not_fused(clock):
    clock.feed(batch("a", 0, T0), batch("a", 0, T0), batch("a", 1, T0 + MS), batch("a", 0, T0))
    assert len(clock.at(MS)) == 2
    assert clock.stats.duplicates == 2


def test_a_batch_that_fills_a_gap_is_no_duplicate(clock):
    clock.feed(batch("a", 0, T0), batch("a", 2, T0 + 2 * MS), batch("a", 1, T0 + MS))
    assert [row[0] for row in clock.at(5 * MS)] == [0, 1, 2]
    assert (clock.stats.lost, clock.stats.duplicates) == (1, 0)


def test_batches_before_the_first_one_seen_are_new_once(clock):
    clock.feed(batch("a", 5, T0 + 5 * MS), batch("a", 3, T0 + 3 * MS), batch("a", 3, T0 + 3 * MS))
    assert len(clock.at(5 * MS)) == 2
    assert clock.stats.duplicates == 1


def test_batches_of_a_session_that_is_over_are_dropped(clock):
    clock.feed(batch("a", 0, T0), batch("a", 0, T0 + 10 * MS, session="b" * 16))
    clock.at(10 * MS)
    clock.feed(batch("a", 1, T0 + 20 * MS))
    assert clock.at(20 * MS) == []
    assert clock.stats.late == 1


def test_a_flood_of_sessions_and_gaps_keeps_memory_bounded(clock):
    for k in range(6_000):
        clock.feed(batch("a", 0, T0 + 10 * S, session=f"{k:016x}"))
    clock.feed(batch("b", 0, T0), batch("b", 2**60, T0 + MS))
    clock.at(MS)
    log = clock.timeline._sequences
    assert len(log._logs) <= 4_096
    assert all(len(entry.missing) <= 4_096 for entry in log._logs.values())
    assert clock.stats.lost == 2**60 - 1


def test_an_empty_batch_moves_the_watermark(clock):
    clock.feed(batch("a", 0, T0 + 50 * MS, ids=()))
    clock.at(50 * MS)
    assert clock.watermark == 50


def test_a_slow_source_gives_its_trajectories_three_periods():
    clock = Clockwork()
    for k in range(5):
        clock.feed(batch("slow", k, T0 + k * 400 * MS))
    clock.at(1_600 * MS)
    assert clock.timeline.track_timeout_ns("slow") == 1_200 * MS
    assert clock.timeline.track_timeout_ns("unknown") == 500 * MS
