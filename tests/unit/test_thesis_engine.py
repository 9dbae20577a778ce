"""The method of the thesis over live trajectories, and its clusterings where the answer is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comotion import Fusion, FusionConfig
from comotion.config import ThesisConfig
from comotion.thesis.clustering import by_appearance, make_clustering

from ..builders import batch, labels_of, play

CONFIG = FusionConfig(method="thesis", thesis=ThesisConfig(sigma_switch=0.02))
REST = {i: (0.2 * i, 0.0) for i in range(5)}


class Scene:
    """Feeds one source at 20 Hz; `update` is the last one, `events` are all of them."""

    def __init__(self, config=CONFIG):
        self.fusion, self.frame, self.events = Fusion(config), 0, []

    def run(self, frames, points):
        """Features that are seen at a frame: {id: position}."""
        start, self.frame = self.frame, self.frame + frames

        def seen(k, now):
            here = points(k)
            return batch("cam", k, now, [here[i] for i in sorted(here)], ids=sorted(here))

        updates = play(self.fusion, range(start, self.frame), seen, rate=20)
        self.update = updates[-1]
        self.events += [e for update in updates for e in update.events if e.stamp_ns == update.stamp_ns]

    @property
    def labels(self):
        return labels_of(self.update)

    def told(self):
        return [(e.kind, e.hypothesis, e.others) for e in self.events]


def passing(frame):
    """Three features that go by to the right at 0.4 m/s, from frame 10 on."""
    x = 0.02 * max(frame - 10, 0)
    return {10 + k: (x, 0.5 + 0.1 * k) for k in range(3)}


def both(frame):
    return REST | passing(frame)


def test_confidence_is_the_mean_affinity_to_the_other_members():
    scene = Scene()
    scene.run(40, both)
    snapshot = scene.fusion.affinity("world")
    ids = [track for _, _, track in snapshot.tracks]
    assert ids == scene.update.track_id.tolist()
    for row, track in enumerate(ids):
        mates = [k for k, i in enumerate(ids) if i != track and scene.labels[i] == scene.labels[track]]
        expected = snapshot.matrix[row, mates].mean()
        assert scene.update.track_confidence[row] == pytest.approx(expected, abs=1e-6)


def test_a_body_that_is_hidden_and_comes_back_within_the_window_keeps_its_id():
    scene = Scene()
    scene.run(40, both)
    before, gone = scene.labels, scene.labels[10]
    scene.run(60, lambda _: REST)
    assert set(scene.labels) == set(REST)
    assert scene.told()[2:] == [("absent", gone, [])]
    (listed,) = (h for h in scene.update.hypotheses if h.id == gone)
    assert (listed.absent, listed.size, listed.confirmed) == (True, 0, True)
    scene.run(30, both)
    assert scene.labels == before
    assert [kind for kind, _, _ in scene.told()] == ["born", "split", "absent", "returned"]


def test_a_forgotten_hypothesis_ends_and_its_features_are_grouped_as_new_ones():
    scene = Scene()
    scene.run(40, both)
    rest, moving = scene.labels[0], scene.labels[10]
    assert scene.fusion.forget(moving) == [moving]
    assert scene.fusion.forget(moving) == []
    scene.run(20, both)
    assert scene.labels[0] == rest
    assert moving not in {h.id for h in scene.update.hypotheses}
    assert scene.told()[2:] == [("ended", moving, []), ("born", scene.labels[10], [])]


def test_bodies_that_stay_together_for_longer_than_the_window_merge():
    scene = Scene(CONFIG.model_copy(update={"window": 2.0}))
    scene.run(40, both)
    one, other = scene.labels[0], scene.labels[10]
    scene.run(60, lambda _: both(40))
    assert set(scene.labels.values()) == {one}
    assert scene.told()[-1] == ("merged", one, [other])


DIVISIVE = "divisive-kmeans"
ALL = [DIVISIVE, "gmm-bic", "eigengap", "eigengap-normalized"]
STOP = 0.4


def blocks(sizes, inside=0.9, outside=0.05, noise=0.03, seed=0):
    """Affinity of clusters of given sizes, in a shuffled order; and who is where."""
    rng = np.random.default_rng(seed)
    truth = rng.permutation(np.repeat(np.arange(len(sizes)), sizes))
    a = np.where(truth[:, None] == truth, inside, outside) + rng.normal(0, noise, (len(truth),) * 2)
    a = np.clip((a + a.T) / 2, 0, 1)
    np.fill_diagonal(a, 1.0)
    return a, by_appearance(truth)


def cluster(name, affinity):
    affinity = np.asarray(affinity, np.float32)
    return make_clustering(name, STOP)(affinity, np.arange(len(affinity)))[0]


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("sizes", [(12,), (8, 8), (20, 5, 9), (10, 10, 10, 10)])
def test_clear_blocks_are_found(name, sizes):
    affinity, truth = blocks(sizes)
    np.testing.assert_array_equal(cluster(name, affinity), truth)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("value", [0.0, 0.4, 0.5, 1.0])
@pytest.mark.parametrize("n", [2, 3, 12])
def test_equal_affinities_give_an_answer(name, value, n):
    a = np.full((n, n), value)
    np.fill_diagonal(a, 1.0)
    labels = cluster(name, a)
    assert labels.shape == (n,)
    if name == DIVISIVE:
        assert len(set(labels.tolist())) == (n if value <= STOP else 1)


def _symmetric(n, seed, values):
    rng = np.random.default_rng(seed)
    a = rng.choice(values, (n, n)) if values else rng.uniform(0, 1, (n, n)) ** rng.choice([0.2, 1, 5])
    a = np.triu(a, 1) + np.triu(a, 1).T
    np.fill_diagonal(a, 1.0)
    return a


affinities = st.builds(
    _symmetric,
    st.integers(0, 14),
    st.integers(0, 2**32 - 1),
    st.sampled_from([(), (0.0, 1.0), (0.0, 0.5, 1.0), (0.1, 0.4, 0.41)]),
)


@settings(max_examples=150)
@given(affinity=affinities)
def test_divisive_kmeans_leaves_no_weak_edge_and_stops(affinity):
    labels = cluster(DIVISIVE, affinity)
    for label in set(labels.tolist()):
        inside = np.ix_(labels == label, labels == label)
        assert affinity[inside].min() > STOP
    if len(affinity) and affinity.min() > STOP:
        assert set(labels.tolist()) == {0}
