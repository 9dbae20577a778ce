"""New groups take the id of a remembered hypothesis where they must be it."""

import numpy as np
import pytest

from comotion.hypotheses.appearance import Appearance
from comotion.hypotheses.memory import Newcomer, ObjectMemory
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
