"""Hypotheses keep their ids from one partition to the next (section 3.3 of the thesis)."""

from itertools import count

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comotion.hypotheses.identity import Votes, name_groups
from comotion.matching import largest_first
from comotion.partition import NO_HYPOTHESIS


def propagate(before, clusters, allocate):
    """Hypothesis of each trajectory, by the rule of the thesis."""
    groups = int(clusters.max(initial=-1)) + 1
    return name_groups(Votes(before, before, clusters), groups, largest_first, allocate)[clusters]


def test_what_two_sources_see_outweighs_as_many_features_of_a_third():
    before, groups = np.zeros(25, np.int64), np.repeat([0, 1], [12, 13])
    sources = np.repeat([0, 1, 2], [6, 6, 13])
    ids = count(9)
    for whose, expected in ((sources, [0, 9]), (None, [10, 0])):
        found = name_groups(Votes(before, before, groups, whose), 2, largest_first, lambda: next(ids))
        assert found.tolist() == expected


MATCHES = {
    "newborn clusters are new": ([-1, -1, -1], [0, 1, 0], [100, 101, 100]),
    "the numbers of clusters do not matter": ([5, 5, 7, 7], [1, 1, 0, 0], [5, 5, 7, 7]),
    "newborns join their cluster": ([5, 5, -1, 7], [0, 0, 0, 1], [5, 5, 5, 7]),
    "the larger part of a split keeps the id": ([5] * 5, [0, 0, 1, 1, 1], [100, 100, 5, 5, 5]),
    "the larger part of a merger gives the id": ([5, 5, 7, 7, 7], [0] * 5, [7] * 5),
    # 5 overlaps most with cluster 0 (3), which leaves 7 (2 there, 1 in cluster 1) with cluster 1.
    "the largest overlap is matched first": ([5, 5, 5, 7, 7, 7], [0, 0, 0, 0, 0, 1], [5] * 5 + [7]),
    "more clusters than hypotheses": ([5, 5, 5], [0, 1, 2], [5, 100, 101]),
    "fewer clusters than hypotheses": ([5, 6, 7], [0, 0, 0], [5, 5, 5]),
    "no match without a shared trajectory": ([5, 5, -1, -1], [0, 0, 1, 1], [5, 5, 100, 100]),
}


@pytest.mark.parametrize(("before", "clusters", "expected"), MATCHES.values(), ids=MATCHES)
def test_clusters_take_the_ids_of_the_hypotheses_that_they_continue(before, clusters, expected):
    assert propagate(np.array(before), np.array(clusters, np.intp), count(100).__next__).tolist() == expected


def struck(shared: np.ndarray) -> list[tuple[int, int]]:
    """The rule of the thesis word by word."""
    left, pairs = shared.copy(), []
    while left.any():
        k, m = np.unravel_index(int(left.argmax()), left.shape)
        pairs.append((int(k), int(m)))
        left[k], left[:, m] = 0, 0
    return pairs


@given(st.integers(0, 7), st.integers(0, 7), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_sorting_the_overlaps_gives_the_pairs_of_the_rule(rows, columns, most, seed):
    shared = np.random.default_rng(seed).integers(0, most, (rows, columns))
    assert largest_first(shared) == struck(shared)


labels = st.lists(st.tuples(st.integers(-1, 5), st.integers(0, 5)), max_size=30)


@given(rows=labels)
def test_ids_are_one_to_one_with_clusters_and_matches_are_shared(rows):
    before = np.array([b for b, _ in rows], np.int64)
    # Cluster numbers without gaps.
    clusters = np.unique([c for _, c in rows], return_inverse=True)[1].astype(np.intp)
    now = propagate(before, clusters, count(100).__next__)
    assert len(set(zip(now.tolist(), clusters.tolist(), strict=True))) == len(set(now.tolist()))
    assert len(set(now.tolist())) == len(set(clusters.tolist()))
    for label in set(now.tolist()):
        if label < 100:
            assert ((before == label) & (now == label)).any()
        else:
            # A new hypothesis: all its members' old ones have found another cluster.
            old = set(before[now == label].tolist()) - {NO_HYPOTHESIS}
            assert old <= set(now.tolist())
