"""Each clustering on affinities whose answer is known, and on those that have none."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comotion.thesis.clustering import by_appearance, make_clustering

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
    return clusters(make_clustering(name, STOP), affinity).labels


def clusters(clustering, affinity):
    affinity = np.asarray(affinity, np.float32)
    return clustering(affinity, np.arange(len(affinity)))


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


def test_an_affinity_at_the_stop_divides_and_one_above_does_not():
    at, above = np.eye(2) + STOP * (1 - np.eye(2)), np.eye(2) + (STOP + 1e-6) * (1 - np.eye(2))
    assert cluster(DIVISIVE, at).tolist() == [0, 1]
    assert cluster(DIVISIVE, above).tolist() == [0, 0]


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
