"""The face of the core: what an update lists, what is refused, what survives a restart and a takeover."""

import numpy as np
import pytest

from comotion import Fusion, FusionConfig

from .. import builders
from ..builders import MS, T0, S, labels_of, play
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


RATE = 15


def corners(seq):
    """Four features at rest, four on a body that moves to the right and turns."""
    rest = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
    t = seq / RATE
    c, s = np.cos(0.2 * t), np.sin(0.2 * t)
    body = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]) @ np.array([[c, s], [-s, c]])
    return np.vstack([rest, body + np.array([0.2 + 0.3 * t, 0.5])])


def seen(seq, now):
    return builders.batch("cam", seq, now, corners(seq))


def step(fusion, seq):
    return play(fusion, [seq], seen, rate=RATE, every=1)[0]


@pytest.fixture
def pair():
    """A leader that has run for 4 s, and a standby that has started 2 s later and followed it since."""
    leader, standby = Fusion(session="1" * 16), Fusion(session="2" * 16)
    # Ids of the leader are no longer 1 and 2.
    play(leader, range(10), seen, rate=RATE)
    leader.forget()
    play(leader, range(10, 30), seen, rate=RATE)
    for seq in range(30, 60):
        step(standby, seq)
        standby.follow(step(leader, seq))
    return leader, standby


def test_a_standby_takes_over_with_ids_births_and_poses_of_the_active_service(pair):
    leader, standby = pair
    expected, got = step(leader, 60), step(standby, 60)
    assert labels_of(got) == labels_of(expected)
    assert len(set(labels_of(got).values())) == 2
    for own, led in zip(got.hypotheses, expected.hypotheses, strict=True):
        assert (own.id, own.born_ns) == (led.id, led.born_ns)
        assert own.pose.translation == pytest.approx(led.pose.translation, abs=2e-3)
        assert own.pose.rotation == pytest.approx(led.pose.rotation, abs=5e-3)


def test_a_new_hypothesis_gets_no_id_that_the_active_service_may_have_given(pair):
    leader, standby = pair
    highest = max(h.id for h in step(leader, 60).hypotheses)
    for seq in range(60, 120):
        extra = corners(seq)[4:] * [1.0, -1.0]
        standby.ingest(builders.batch("other", seq, T0 + seq * S // RATE, extra))
        update = step(standby, seq)
    new = {h.id for h in update.hypotheses} - {h.id for h in leader.update(T0 + 4 * S).hypotheses}
    assert new
    assert min(new) > highest + 1
    assert [e.hypothesis for e in update.events if e.kind in ("born", "split")] in ([], sorted(new))


def test_forgetting_names_the_published_id_and_a_restart_keeps_the_names(pair):
    _, standby = pair
    before = step(standby, 60)
    restored = Fusion.restore(FusionConfig(), standby.snapshot(), session="3" * 16)
    assert labels_of(step(restored, 61)) == labels_of(before)
    first = before.hypotheses[0].id
    assert restored.forget(first) == [first]
    assert restored.forget(first) == []
    updates = [step(restored, seq) for seq in range(62, 80)]
    assert [e.hypothesis for e in updates[-1].events if e.kind == "ended"] == [first]
    # Its features are grouped as new ones, under another id.
    (new,) = {*labels_of(updates[-1]).values()} - {h.id for h in before.hypotheses}
    assert {k for k, one in labels_of(updates[-1]).items() if one == new} == {
        k for k, one in labels_of(before).items() if one == first
    }
