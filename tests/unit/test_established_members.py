"""Objects keep their ids through a gap, a restart, a hostile source, and when a standby takes over.

The sources of the first tests are those of the soak, with a seed at which ids changed before established
members had votes.
"""

import heapq
from collections import Counter

import numpy as np
import pytest

from comotion import Fusion, FusionConfig
from comotion_tools.soak.load import BODIES, ID_STEP, KINDS, places, positions

from .. import builders
from ..builders import T0, S, labels_of, play

START = 1_000 * S
NAMES = "left", "right", "arm"
SEED = 7


def stream(name, first, last):
    """Batches of a source with the times of their arrival, in s."""
    kind, rng = KINDS[name], np.random.default_rng([SEED, sum(name.encode())])
    features = places(kind, sum(name.encode()))
    ids = ID_STEP * np.arange(BODIES)[:, None] + np.arange(kind.features)
    for frame in range(int(np.ceil(first * kind.rate)), int(np.ceil(last * kind.rate))):
        seconds = frame / kind.rate + 0.003 * len(name)
        found = positions(kind, features, seconds + 1.7 * SEED)
        found = (found + rng.normal(0, 0.002, found.shape)).reshape(-1, kind.dim)
        fields = {"space": kind.space, "unit": kind.unit, "ids": ids.reshape(-1).astype(np.uint64)}
        yield seconds, builders.batch(name, frame, START + round(seconds * S), found, **fields)


def feed(fusion, *parts, since):
    """Fuse streams in the order of arrival with updates from a time in s on: the last, kinds of events."""
    due, kinds = since, set()
    for seconds, batch in heapq.merge(*parts, key=lambda part: part[0]):
        while seconds >= due:
            update = fusion.update(START + round(due * S))
            kinds |= {e.kind for e in update.events if e.stamp_ns == update.stamp_ns}
            due += 0.1
        fusion.ingest(batch)
        fusion.advance(START + round(seconds * S))
    return update, kinds


def objects_of(update):
    """Hypothesis of each body, that of most of its features."""
    ours = np.isin([source.name for source in update.sources], NAMES)[update.track_source]
    bodies, labels = update.track_id[ours] // ID_STEP, update.track_hypothesis[ours]
    return [Counter(labels[bodies == body].tolist()).most_common(1)[0][0] for body in range(BODIES)]


def test_after_a_gap_longer_than_the_window_and_a_restart_every_object_has_its_id():
    """The sources come back one after the other."""
    fusion = Fusion()
    before, _ = feed(fusion, *(stream(name, 0, 8) for name in NAMES), since=0.1)
    assert len(set(objects_of(before))) == BODIES
    fusion = Fusion.restore(FusionConfig(), fusion.snapshot())
    back = {"left": 38.0, "right": 38.15, "arm": 37.8}
    after, kinds = feed(fusion, *(stream(name, first, 43) for name, first in back.items()), since=37.7)
    assert objects_of(after) == objects_of(before)
    assert {h.id: h.born_ns for h in after.hypotheses} == {h.id: h.born_ns for h in before.hypotheses}
    assert kinds <= {"joined", "released"}


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
    for mine, theirs in zip(got.hypotheses, expected.hypotheses, strict=True):
        assert (mine.id, mine.born_ns) == (theirs.id, theirs.born_ns)
        assert mine.pose.translation == pytest.approx(theirs.pose.translation, abs=2e-3)
        assert mine.pose.rotation == pytest.approx(theirs.pose.rotation, abs=5e-3)


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
    update = step(restored, 61)
    assert labels_of(update) == labels_of(before)
    one = before.hypotheses[0].id
    assert restored.forget(one) == [one]
    assert restored.forget(one) == []
