"""Each clustering on affinities whose answer is known, and on those that have none."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.cluster import KMeans

from comotion.thesis.clustering import by_appearance, make_clustering
from comotion.thesis.halving import halve
from comotion.thesis.kernels import gather

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


@pytest.mark.parametrize("seed", range(5))
def test_divisive_kmeans_finds_blocks_of_very_different_size(seed):
    affinity, truth = blocks((60, 3, 1, 11), noise=0.05, seed=seed)
    np.testing.assert_array_equal(cluster(DIVISIVE, affinity), truth)


@pytest.mark.parametrize("name", ALL)
def test_no_trajectory_and_one(name):
    assert cluster(name, np.zeros((0, 0))).tolist() == []
    assert cluster(name, [[1.0]]).tolist() == [0]


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


def test_edges_between_halves_are_cut():
    """After a split the other half's columns no longer count: here they alone would divide again."""
    a, truth = blocks((10, 10), inside=0.95, outside=0.1, noise=0.0)
    first = np.flatnonzero(truth == 0)
    a[np.ix_(first[:5], truth == 1)] = a[np.ix_(truth == 1, first[:5])].T * 0 + 0.35
    a = (a + a.T) / 2
    np.testing.assert_array_equal(cluster(DIVISIVE, a), truth)


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


@settings(max_examples=25)
@given(affinity=affinities)
@pytest.mark.parametrize("name", ["eigengap", "eigengap-normalized"])
def test_spectral_clustering_answers_for_any_affinity(name, affinity):
    labels = cluster(name, affinity)
    assert labels.shape == (len(affinity),)
    np.testing.assert_array_equal(labels, by_appearance(labels))


@pytest.mark.parametrize("count", [1, 2, 40, 299])
def test_rows_and_columns_are_gathered(count):
    rng = np.random.default_rng(count)
    matrix, members = rng.uniform(size=(300, 300)).astype(np.float32), rng.choice(300, count, replace=False)
    np.testing.assert_array_equal(gather(matrix, members), matrix[np.ix_(members, members)])


@pytest.mark.parametrize("sizes", [(14, 9, 6), (140, 90, 60)])
@pytest.mark.parametrize("seed", range(5))
def test_the_first_split_is_as_good_as_that_of_ten_random_starts(sizes, seed):
    rng = np.random.default_rng(seed)
    affinity, _ = blocks(sizes, inside=0.7, outside=0.3, noise=rng.uniform(0.05, 0.3), seed=seed)
    theirs = KMeans(2, n_init=10, random_state=0).fit(affinity)
    single = affinity.astype(np.float32)
    second = halve(single, single.sum(1), np.zeros(len(single), bool))
    ours = sum(((half - half.mean(axis=0)) ** 2).sum() for half in (affinity[second], affinity[~second]))
    assert ours <= 1.02 * theirs.inertia_


@pytest.mark.parametrize("seed", range(3))
def test_a_first_guess_from_the_call_before_changes_nothing_about_the_answer(seed):
    cluster = make_clustering(DIVISIVE, STOP)
    for sizes in ((60, 30, 40), (60, 30, 40), (50, 50, 30), (130,), (20, 20, 20, 70)):
        affinity, truth = blocks(sizes, seed=seed)
        np.testing.assert_array_equal(clusters(cluster, affinity).labels, truth)
