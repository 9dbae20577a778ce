"""Groups take the ids of the hypotheses that they continue, or of remembered ones where they must be it."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from comotion.hypotheses.identity import balanced, recognised
from comotion.hypotheses.records import Current, Record
from comotion.matching import continued, largest_first
from comotion.partition import NO_HYPOTHESIS, PoseReference
from comotion_schemas import Twist

from ..builders import S, hypothesis

CORNERS = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])


def described(one, velocity=(0.0, 0.0, 0.0), state="moving"):
    twist = Twist(linear=list(velocity), angular=[0.0, 0.0, 0.0])
    return hypothesis(one, size=8, state=state, twist=twist)


def current(places, count=8):
    """Of each hypothesis by id and centre; its features are 100 id, 100 id + 1 and on."""
    keys = np.concatenate([100 * one + np.arange(count) for one in places])
    positions = np.concatenate([CORNERS[:count] + centre for centre in places.values()])
    labels = np.repeat(list(places), count)
    return Current(keys, np.arange(len(keys)), labels, positions, np.ones(len(keys), bool))


def appeared(seconds, centre, scale=1.0):
    return round(seconds * S), CORNERS * scale + centre


def memory(*bodies):
    """Of (id, centre, velocity, static) at time 0; the features of hypothesis i are 100 i to 100 i + 7."""
    found = {}
    for one, centre, velocity, static in bodies:
        found[one] = Record(PoseReference.new(0), description=described(one, velocity), static=static)
        found[one].see(0, one, current({one: centre}), posed=False)
    return found


STILL = (0.0, 0.0, 0.0)
HERE = (1, (0, 0, 0), STILL, False)
SLOW = (1, (0, 0, 0), (0.3, 0, 0), False)
RECOGNISED = {
    "at its place": (
        [HERE, (2, (1, 0, 0), STILL, False)],
        {7: appeared(1, (1.02, 0, 0)), 8: appeared(1, (0, 0.03, 0))},
        {7: 2, 8: 1},
    ),
    "not elsewhere": ([HERE], {7: appeared(1, (1, 0, 0))}, {}),
    "not with another extent": ([HERE], {7: appeared(1, (0, 0, 0), scale=10)}, {}),
    "not far off soon after": ([SLOW], {7: appeared(0.1, (-0.8, 0, 0))}, {}),
    "farther off after a while": ([SLOW], {7: appeared(3, (-0.8, 0, 0))}, {7: 1}),
    "not between two equal places": (
        [(1, (0, 0, 0.1), STILL, False), (2, (0, 0, -0.1), STILL, False)],
        {7: appeared(1, (0, 0, 0))},
        {},
    ),
    "the static body wherever it is": (
        [(1, (0, 0, 0), STILL, True), (2, (5, 0, 0), STILL, False)],
        {7: None},
        {7: 1},
    ),
}


@pytest.mark.parametrize(("known", "new", "expected"), RECOGNISED.values(), ids=RECOGNISED)
def test_a_body_is_recognised(known, new, expected):
    assert recognised(memory(*known), new, 1.0) == expected


def test_a_body_is_expected_about_the_place_where_it_has_been():
    def passed_by(to):
        found = {one: Record(PoseReference.new(0), description=described(one)) for one in (1, 2)}
        for second in range(11):
            places = {1: (0.0, 0.0, 0.0), 2: (1.0, 0.0, 0.0)} if second < 10 else {1: to, 2: to}
            for one, record in found.items():
                record.see(second * S, one, current(places), posed=False)
        return found

    new = {7: appeared(13, (0.9, 0, 0)), 8: appeared(13, (0.1, 0, 0))}
    assert recognised(passed_by((0.5, 0.0, 0.0)), new, 1.0) == {7: 2, 8: 1}


def test_what_two_sources_see_outweighs_as_many_features_of_a_third():
    before, groups = np.zeros(25, np.int64), np.repeat([0, 1], [12, 13])
    sources = np.repeat([0, 1, 2], [6, 6, 13])
    for whose, expected in ((sources, {0: 0}), (0 * sources, {1: 0})):
        assert continued(before, groups, 2, largest_first, balanced(before, whose)) == expected


def struck(shared: np.ndarray) -> list[tuple[int, int]]:
    """The rule of the thesis word by word."""
    left, pairs = shared.copy(), []
    while left.any():
        k, m = np.unravel_index(int(left.argmax()), left.shape)
        pairs.append((int(k), int(m)))
        left[k], left[:, m] = 0, 0
    return pairs


@given(st.lists(st.tuples(st.integers(-1, 5), st.integers(0, 5)), max_size=30))
@example([(5, 0)] * 3 + [(7, 0)] * 2 + [(7, 1)])  # 5 overlaps most with 0, which leaves 7 with 1
def test_clusters_continue_hypotheses_by_the_rule_of_the_thesis(rows):
    before = np.array([b for b, _ in rows], np.int64)
    # Cluster numbers without gaps.
    clusters = np.unique([c for _, c in rows], return_inverse=True)[1].astype(np.intp)
    old = before != NO_HYPOTHESIS
    known, row = np.unique(before[old], return_inverse=True)
    shared = np.zeros((len(known), clusters.max(initial=-1) + 1), int)
    np.add.at(shared, (row, clusters[old]), 1)
    expected = {c: int(known[h]) for h, c in struck(shared)}
    assert continued(before, clusters, shared.shape[1], largest_first) == expected
