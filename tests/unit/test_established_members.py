"""Objects keep their ids when a standby takes over, and when it is restarted."""

import numpy as np
import pytest

from comotion import Fusion, FusionConfig

from .. import builders
from ..builders import T0, S, labels_of, play

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
    update = step(restored, 61)
    assert labels_of(update) == labels_of(before)
    first = before.hypotheses[0].id
    assert restored.forget(first) == [first]
    assert restored.forget(first) == []
