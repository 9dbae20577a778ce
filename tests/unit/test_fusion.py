"""The face of the core: what an update lists, what is refused, what survives a restart."""

import numpy as np
import pytest

from comotion import Fusion, FusionConfig
from comotion_schemas import encode

from .. import builders
from ..builders import MS, T0, S, play
from ..builders import by_feature as tracks_of


@pytest.fixture(params=["comotion", "thesis"])
def config(request):
    return FusionConfig(method=request.param)


def batch(source, seq, stamp_ns, positions, *, first_id=0, **fields):
    ids = np.arange(first_id, first_id + len(positions), dtype=np.uint64)
    return builders.batch(source, seq, stamp_ns, positions, ids=ids, **fields)


def two_bodies(t):
    """Four features at rest, three that move right at 0.3 m/s."""
    rest = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
    return np.array([*rest, *([0.2 + 0.3 * t, y] for y in (0.4, 0.5, 0.6))])


def run(fusion, start, stop, *, session="a" * 16):
    """Feed two bodies at 15 Hz from one time to another, s, and update after each batch; the updates."""
    frames = range(round(15 * start), round(15 * stop))
    return play(
        fusion, frames, lambda k, now: batch("cam", k, now, two_bodies(k / 15), session=session), rate=15
    )


def test_two_bodies_become_two_hypotheses_with_stable_ids(config):
    updates = run(Fusion(config), 0, 4)
    labels = tracks_of(updates[-1])
    rest, moving = {labels["cam", i] for i in range(4)}, {labels["cam", i] for i in range(4, 7)}
    assert len(rest) == len(moving) == 1
    assert rest != moving
    assert tracks_of(updates[-10]) == labels
    assert updates[-1].stamp_ns == T0 + round(59 / 15 * S)
    assert sorted(h.size for h in updates[-1].hypotheses) == [3, 4]


def test_what_ended_leaves_the_next_update_and_what_is_not_observed_leaves_after_the_timeout(config):
    fusion = Fusion(config)
    run(fusion, 0, 1)

    def fewer(k, now):
        ended = np.array([0, 1], np.uint64) if k == 15 else None
        return batch("cam", k, now, two_bodies(1)[2:5], first_id=2, ended=ended)

    first, *_, last = play(fusion, range(15, 25), fewer, rate=15)
    assert set(tracks_of(first)) == {("cam", i) for i in range(2, 7)}
    assert set(tracks_of(last)) == {("cam", i) for i in range(2, 5)}


def test_a_trajectory_that_comes_back_within_the_window_keeps_its_label(config):
    fusion = Fusion(config)
    before = tracks_of(run(fusion, 0, 4)[-1])
    seen = lambda k, now: batch("cam", k, now, two_bodies(k / 15)[: 6 if k < 75 else 7])  # noqa: E731
    *_, gap, after = map(tracks_of, play(fusion, range(60, 76), seen, rate=15))
    assert ("cam", 6) not in gap
    assert after == before


def test_a_new_session_ends_the_old_ones_trajectories(config):
    fusion = Fusion(config)
    run(fusion, 0, 1)
    update = run(fusion, 1, 1.4, session="b" * 16)[-1]
    assert [s.session for s in update.sources] == ["b" * 16]
    assert len(update.track_id) == 7


def test_the_order_of_arrival_across_sources_does_not_matter(config):
    def feed(order):
        fusion = Fusion(config)
        for k in range(45):
            now = T0 + k * 66 * MS
            seen = two_bodies(k * 0.066)
            pair = batch("left", k, now - 20 * MS, seen[:4]), batch("right", k, now, seen[4:])
            for index in order:
                fusion.ingest(pair[index])
            yield encode(fusion.update(now))

    # Byte for byte, as of any fusion that is fed the same.
    assert list(feed((0, 1))) == list(feed((1, 0)))


def test_a_newcomer_gets_its_share_of_the_trajectories(config):
    fusion = Fusion(config.model_copy(update={"max_tracks": 7}))
    run(fusion, 0, 1)
    for seq in range(3):
        begin = 1 + seq / 5
        fusion.ingest(batch("late", seq, T0 + round(begin * S), two_bodies(begin), space="other"))
        update = run(fusion, begin, begin + 0.2)[-1]
    held = [source for source, _ in tracks_of(update)]
    assert (held.count("cam"), held.count("late")) == (4, 3)
    # The oldest trajectories of the greedy source stay.
    assert {track for source, track in tracks_of(update) if source == "cam"} == {0, 1, 2, 3}
    assert fusion.stats.rejected == {}
    assert fusion.stats.refused_rows > 0


def test_what_comes_back_counts_before_what_is_new(config):
    fusion = Fusion(config.model_copy(update={"max_tracks": 12}))
    seen = []
    for k in range(40):
        now = T0 + k * 100 * MS
        fusion.ingest(batch("clock", k, now, np.zeros((1, 2))))
        # Ten features, nothing for two seconds, then these and thirty more.
        if k < 10 or k >= 30:
            fusion.ingest(batch("cam", k, now, np.zeros((10 if k < 10 else 40, 2))))
        seen.append({track for source, track in tracks_of(fusion.update(now)) if source == "cam"})
    assert seen[28] == set()
    assert set(range(10)) <= seen[-1]
    assert max(map(len, seen)) <= 11


@pytest.mark.parametrize(("most", "full"), [(40, False), (20, True)])
def test_churn_starves_no_new_trajectories_and_outdated_ones_are_bounded(config, most, full):
    fusion = Fusion(config.model_copy(update={"max_tracks": most}))
    sizes = []
    for k in range(60):
        now = T0 + k * 300 * MS
        # Every trajectory is seen twice, so that it stays in the window after its death.
        fusion.ingest(batch("cam", k, now, np.zeros((8, 2)), first_id=4 * k))
        update = fusion.update(now)
        assert full or {("cam", 4 * k + i) for i in range(8)} <= set(tracks_of(update))
        sizes.append(len(fusion.snapshot()))
    assert fusion.stats.rejected == {}
    assert (fusion.stats.refused_rows > 0) == full
    assert max(sizes) < 1.2 * max(sizes[: 30 if full else 40])


def newest_hypothesis(fusion, now):
    """Id of the hypothesis that begins with three features in a space of their own."""
    fusion.ingest(batch("new", 0, now, two_bodies(0)[:3], space="new"))
    for k in range(1, 16):
        fusion.ingest(batch("new", k, now + k * 66 * MS, two_bodies(0)[:3], space="new"))
    update = fusion.update(now + S)
    return max(h.id for h in update.hypotheses if h.space == "new")


def test_after_a_crash_no_hypothesis_id_is_used_again(config):
    fusion = Fusion(config)
    run(fusion, 0, 4)
    data = fusion.snapshot()
    # What the snapshot does not know: a hypothesis that began after it.
    used = newest_hypothesis(fusion, T0 + 4 * S)
    assert newest_hypothesis(Fusion.restore(config, data), T0 + 4 * S) > used


def test_a_clean_snapshot_continues_exactly(config):
    fusion = Fusion(config)
    run(fusion, 0, 4)
    twin = Fusion.restore(config, fusion.snapshot(clean=True))
    mine, theirs = (run(f, 4, 5)[-1] for f in (fusion, twin))
    assert tracks_of(mine) == tracks_of(theirs)
    assert np.allclose(fusion.affinity("world").matrix, twin.affinity("world").matrix, atol=1e-6)
    assert newest_hypothesis(twin, T0 + 5 * S) == newest_hypothesis(fusion, T0 + 5 * S)


def test_events_are_repeated_for_two_seconds(config):
    fusion = Fusion(config)
    updates = run(fusion, 0, 4)
    at = next(k for k, u in enumerate(updates) if u.events)
    first = updates[at].events
    assert all(first[0] in u.events for u in updates[at : at + 19])
    assert first[0] not in updates[-1].events
