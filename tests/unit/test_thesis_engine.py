"""The method of the thesis over live trajectories, and its clusterings where the answer is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comotion import Fusion, FusionConfig
from comotion.config import ThesisConfig
from comotion.thesis.clustering import by_appearance, make_clustering

from ..builders import batch, labels_of, play

CONFIG = FusionConfig(method="thesis", window=2.0, thesis=ThesisConfig(sigma_switch=0.02))


def passing(k, now):
    """Five features at rest, and three that go by to the right at 0.4 m/s and then stay."""
    places = [(0.2 * i, 0.0) for i in range(5)] + [(0.02 * min(k, 40), 0.5 + 0.1 * i) for i in range(3)]
    return batch("cam", k, now, np.array(places) + np.random.default_rng(k).normal(0, 0.002, (8, 2)))


def test_confidence_is_the_mean_affinity_and_what_stays_together_merges():
    fusion = Fusion(CONFIG)
    update = play(fusion, range(40), passing, rate=20)[-1]
    labels, snapshot = labels_of(update), fusion.affinity("world")
    assert labels[0] != labels[5]
    for row, (_, _, track) in enumerate(snapshot.tracks):
        mates = [
            k for k, (_, _, i) in enumerate(snapshot.tracks) if i != track and labels[i] == labels[track]
        ]
        expected = snapshot.matrix[row, mates].mean()
        assert update.track_confidence[row] == pytest.approx(expected, abs=1e-6)
    together = play(fusion, range(40, 100), passing, rate=20)[-1]
    assert set(labels_of(together).values()) == {labels[0]}
    assert [(e.kind, e.hypothesis, e.others) for e in together.events] == [("merged", labels[0], [labels[5]])]


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
        assert affinity[np.ix_(labels == label, labels == label)].min() > STOP
    if len(affinity) and affinity.min() > STOP:
        assert set(labels.tolist()) == {0}
