"""New groups take the id of a remembered hypothesis where they must be it."""

import numpy as np
import pytest

from comotion.hypotheses.appearance import Appearance
from comotion.hypotheses.memory import Newcomer, ObjectMemory, clear_pairs
from comotion.partition import PoseReference
from comotion_schemas import Hypothesis, Twist

S = 1_000_000_000
CORNERS = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])


def described(one, velocity=(0.0, 0.0, 0.0), state="moving"):
    twist = Twist(linear=list(velocity), angular=[0.0, 0.0, 0.0])
    centroid = [0.0, 0.0, 0.0]
    return Hypothesis(id=one, space="world", size=8, born_ns=0, state=state, centroid=centroid, twist=twist)


def group(first, centre, scale=1.0, static=False):
    return Newcomer(np.arange(first, first + 8), CORNERS * scale + centre, static)


def seen(seconds, centre, velocity=(0.0, 0.0, 0.0), scale=1.0):
    return Appearance(round(seconds * S), CORNERS * scale + centre, np.array(velocity))


def memory(*seen):
    """Of (id, centre, velocity, static) at time 0; the features of hypothesis i are 100 i to 100 i + 7."""
    found, current = ObjectMemory(), np.arange(1000)
    for one, centre, velocity, static in seen:
        members = group(100 * one, centre, static=static)
        found.see(0, members, current, described(one, velocity), PoseReference.new(0))
    return found


STILL = (0.0, 0.0, 0.0)
HERE = (1, (0, 0, 0), STILL, False)
SLOW = (1, (0, 0, 0), (0.3, 0, 0), False)
MEETING = [(1, (0, 0, 0), (1.0, 0, 0), False), (2, (0.8, 0, 0), (-1.0, 0, 0), False)]
RECOGNISED = {
    "at its place": (
        [HERE, (2, (1, 0, 0), STILL, False)],
        {7: seen(1, (1.02, 0, 0)), 8: seen(1, (0, 0.03, 0))},
        {7: 2, 8: 1},
    ),
    "not elsewhere": ([HERE], {7: seen(1, (1, 0, 0))}, {}),
    "not with another extent": ([HERE], {7: seen(1, (0, 0, 0), scale=10)}, {}),
    "where its motion leads": (
        MEETING,
        {7: seen(0.5, (0.3, 0, 0), (-1.0, 0, 0)), 8: seen(0.5, (0.5, 0, 0), (1.0, 0, 0))},
        {7: 2, 8: 1},
    ),
    "not far off soon after": ([SLOW], {7: seen(0.1, (-0.8, 0, 0))}, {}),
    "farther off after a while": ([SLOW], {7: seen(3, (-0.8, 0, 0))}, {7: 1}),
    "not between two equal places": (
        [(1, (0, 0, 0.1), STILL, False), (2, (0, 0, -0.1), STILL, False)],
        {7: seen(1, (0, 0, 0))},
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
    assert memory(*known).recognised([one[0] for one in known], new, 1.0) == expected


def test_a_body_is_expected_about_the_place_where_it_has_been():
    def passed_by(to):
        found, current = ObjectMemory(), np.arange(1000)
        for second in range(11):
            for one, place in ((1, (0.0, 0.0, 0.0)), (2, (1.0, 0.0, 0.0))):
                at = to if second == 10 else place
                found.see(second * S, group(100 * one, at), current, described(one), PoseReference.new(0))
        return found

    new = {7: seen(13, (0.9, 0, 0)), 8: seen(13, (0.1, 0, 0))}
    assert passed_by((0.5, 0.0, 0.0)).recognised([1, 2], new, 1.0) == {7: 2, 8: 1}


def test_the_heir_has_most_of_the_last_members():
    found = memory(HERE)
    keys = np.arange(100, 108)
    assert found.heir(1, keys, np.array([5, 5, 5, 5, 5, 6, 6, -1])) == 5
    assert found.heir(1, keys[:4], np.array([5, 5, 5, 5])) is None


def test_lost_features_are_remembered_for_a_while():
    found = memory(HERE)
    few = Newcomer(np.arange(100, 103), CORNERS[:3], static=False)
    found.see(S, few, few.keys, described(1), PoseReference.new(0))
    assert len(found.traces[1].keys) == 8
    found.see(4 * S, few, few.keys, described(1), PoseReference.new(0))
    assert len(found.traces[1].keys) == 3


def test_state_survives():
    found = memory((1, (0, 0, 0), (0.5, 0, 0), False))
    twin = ObjectMemory()
    twin.load(found.state())
    assert twin.traces[1].description == found.traces[1].description
    np.testing.assert_array_equal(twin.traces[1].brought_up, found.traces[1].brought_up)
    np.testing.assert_array_equal(twin.traces[1].place, found.traces[1].place)


@pytest.mark.parametrize(
    ("costs", "pairs"),
    [
        ([[0.0, 5.0], [5.0, 0.0]], [(0, 0), (1, 1)]),
        ([[0.0, 0.5], [0.5, 0.0]], []),
        ([[0.0], [1.0]], []),
        ([[0.0], [9.0]], [(0, 0)]),
        ([[np.inf, 3.0]], [(0, 1)]),
        ([[np.inf]], []),
    ],
)
def test_only_clear_pairs_are_matched(costs, pairs):
    assert clear_pairs(np.array(costs), 2.0) == pairs
