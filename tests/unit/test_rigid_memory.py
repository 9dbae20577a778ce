"""What has moved apart stays apart while it rests; what was never apart does not."""

import numpy as np
import pytest

from comotion.config import RigidConfig
from comotion.rigid.assignment import Assignment, SearchResult
from comotion.rigid.belief import Belief, carried_costs
from comotion.rigid.costs import Costs
from comotion.rigid.kernels.records import ROUND
from comotion.rigid.procrustes import Body, static_body
from comotion.rigid.resampling import Frames

SECOND = 10**9
KEYS = np.array([3, 5, 8, 13, 21, 34])
IDS, BEFORE = np.array([7, 9]), np.array([7, 7, 7, 9, 9, 9])
MOVES = [[40, 500]] * 3 + [[400, 40]] * 3
RESTS = [[40, 60]] * 3 + [[45, 40]] * 3
CONTRADICTED = [[40, 60]] * 3 + [[40, 60]] * 3


def frames_at(stamp_ns, keys=KEYS):
    n = len(keys)
    ones, stamps = np.ones(n), stamp_ns - np.arange(29, -1, -1) * SECOND // 15
    noise = ones, ones, np.tile(ROUND, (n, 1)), np.tile([1.0, 0.0, 0.0], (n, 1))
    y, w = np.zeros((n, 30, 3)), np.ones((n, 30))
    return Frames(3, stamps, y, w, np.arange(n), ones, *noise, keys, np.full(n, 2.0), np.ones(n, bool))


def result_of(body_costs):
    """Two bodies with three trajectories each, the first one static, and what each trajectory costs."""
    still = static_body(30)
    moving = Body(np.arange(3, 6), np.zeros((3, 3)), still.R, still.t, still.posed, 6)
    labels, prices = np.array([0, 0, 0, 1, 1, 1]), np.array([0.0, 100.0])
    evidence = Costs(np.array(body_costs, float), np.full(6, 500.0), prices, prices)
    cost = np.column_stack([evidence.outlier, evidence.body])
    return SearchResult([still, moving], Assignment(labels, cost), evidence, np.zeros(6))


def learnt(*steps):
    belief, stamp = Belief(), 0
    for costs, seconds in steps:
        for _ in range(round(seconds * 4) + 1):
            belief.learn(result_of(costs), frames_at(stamp), IDS)
            stamp += SECOND // 4
    return belief


def scene_of(belief, before=BEFORE, keys=KEYS):
    frames = frames_at(10**15, keys)
    return belief.scene(frames, np.zeros((len(keys), 3)), before, 7, RigidConfig().min_life)


@pytest.mark.parametrize(
    ("steps", "known"),
    [
        ([(MOVES, 0.5)], False),
        ([(MOVES, 1.25)], True),
        ([(MOVES, 2), (RESTS, 600)], True),
        ([(RESTS, 60)], False),
        ([(MOVES, 2), (CONTRADICTED, 1)], True),
        ([(MOVES, 2), (CONTRADICTED, 3)], False),
    ],
)
def test_a_body_is_separate_once_it_has_clearly_moved_for_a_second_until_that_is_contradicted(steps, known):
    np.testing.assert_array_equal(scene_of(learnt(*steps)).separate, (BEFORE == 9) & known)


def test_a_separate_body_rests_where_it_did_not_clearly_move_last():
    assert not scene_of(learnt((MOVES, 2))).resting.any()
    np.testing.assert_array_equal(scene_of(learnt((MOVES, 2), (RESTS, 1))).resting, BEFORE == 9)


def test_a_trajectory_is_a_clear_member_once_no_other_body_explains_it_and_stays_one_at_rest():
    assert not scene_of(learnt((RESTS, 0))).clear.any()
    assert scene_of(learnt((MOVES, 0), (RESTS, 0))).clear.all()
    other = scene_of(learnt((MOVES, 0)), before=np.array([7, 7, 9, 9, 9, 7]))
    np.testing.assert_array_equal(other.clear, [1, 1, 0, 1, 1, 0])


def test_clear_members_pay_for_leaving():
    paid = carried_costs(scene_of(learnt((MOVES, 0))), [np.zeros(0, int), np.arange(3, 6)])
    np.testing.assert_array_equal(paid > 0, [[0, 1]] * 3 + [[1, 0]] * 3)


def test_what_is_believed_survives_a_restart_and_what_is_gone_is_forgotten():
    belief = learnt((MOVES, 2))
    again = Belief()
    again.load(belief.state())
    scene = scene_of(again)
    assert scene.clear.all()
    np.testing.assert_array_equal(scene.separate, BEFORE == 9)
    scene_of(again, BEFORE[:3], KEYS[:3])
    assert not again.records
