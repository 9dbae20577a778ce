"""Hypotheses keep their ids from one partition to the next (section 3.3 of the thesis)."""

from itertools import count

import numpy as np
from hypothesis import example, given
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


@given(st.lists(st.tuples(st.integers(-1, 5), st.integers(0, 5)), max_size=30))
@example([(5, 0)] * 3 + [(7, 0)] * 2 + [(7, 1)])  # 5 overlaps most with 0, which leaves 7 with 1
def test_clusters_take_the_ids_of_the_hypotheses_that_they_continue_and_others_new_ones(rows):
    before = np.array([b for b, _ in rows], np.int64)
    # Cluster numbers without gaps.
    clusters = np.unique([c for _, c in rows], return_inverse=True)[1].astype(np.intp)
    old = before != NO_HYPOTHESIS
    known, row = np.unique(before[old], return_inverse=True)
    shared = np.zeros((len(known), clusters.max(initial=-1) + 1), int)
    np.add.at(shared, (row, clusters[old]), 1)
    new = count(100)
    continued = {c: int(known[h]) for h, c in struck(shared)}
    expected = {c: continued[c] if c in continued else next(new) for c in sorted(set(clusters.tolist()))}
    now = propagate(before, clusters, count(100).__next__)
    assert now.tolist() == [expected[c] for c in clusters.tolist()]
