"""What has moved apart stays apart while it rests; what was never apart does not."""

import numpy as np

from comotion.rigid.assignment import Assignment, SearchResult
from comotion.rigid.costs import Costs
from comotion.rigid.members import ClearMembers
from comotion.rigid.memory import Separation
from comotion.rigid.procrustes import Body, static_body

SECOND = 10**9


def result_of(body_costs):
    """Two bodies with three trajectories each, the first one static, and what each trajectory costs."""
    still = static_body(30)
    moving = Body(np.arange(3, 6), np.zeros((3, 3)), still.R, still.t, still.posed, 6)
    labels = np.array([0, 0, 0, 1, 1, 1])
    evidence = Costs(
        np.array(body_costs, float), np.full(6, 500.0), np.array([0.0, 100.0]), np.array([0.0, 100.0])
    )
    cost = np.column_stack([evidence.outlier, evidence.body])
    return SearchResult([still, moving], Assignment(labels, cost), evidence, np.zeros(6))


MOVES = [[40, 500]] * 3 + [[400, 40]] * 3
RESTS = [[40, 60]] * 3 + [[45, 40]] * 3
CONTRADICTED = [[40, 60]] * 3 + [[40, 60]] * 3
IDS, BEFORE = np.array([7, 9]), np.array([7, 7, 7, 9, 9, 9])


def learnt(*steps):
    separation, stamp = Separation(), 0
    for costs, seconds in steps:
        for _ in range(round(seconds * 4) + 1):
            separation.learn(result_of(costs), IDS, stamp)
            stamp += SECOND // 4
    return separation


def test_a_body_that_has_clearly_moved_for_a_second_is_known_to_be_separate():
    assert not learnt((MOVES, 0.5)).known(BEFORE).any()
    np.testing.assert_array_equal(learnt((MOVES, 1.25)).known(BEFORE), BEFORE == 9)


def test_it_stays_known_through_rest_of_any_length():
    np.testing.assert_array_equal(learnt((MOVES, 2), (RESTS, 600)).known(BEFORE), BEFORE == 9)


def test_a_body_that_never_clearly_moved_is_not_known():
    assert not learnt((RESTS, 60)).known(BEFORE).any()


def test_seconds_of_evidence_to_the_contrary_forget_it_and_less_does_not():
    assert learnt((MOVES, 2), (CONTRADICTED, 1)).known(BEFORE).any()
    assert not learnt((MOVES, 2), (CONTRADICTED, 3)).known(BEFORE).any()


def test_what_is_gone_is_forgotten_and_what_is_known_survives_a_restart():
    separation = learnt((MOVES, 2))
    again = Separation()
    again.load(separation.state())
    np.testing.assert_array_equal(again.known(BEFORE), BEFORE == 9)
    again.keep(np.array([7]))
    assert not again.known(BEFORE).any()


KEYS = np.array([3, 5, 8, 13, 21, 34])


def members_after(*costs):
    members = ClearMembers()
    for one in costs:
        members.learn(result_of(one), KEYS, IDS)
    return members


def test_a_trajectory_is_a_clear_member_once_no_other_body_explains_it_and_stays_one_at_rest():
    assert not members_after(RESTS).known(KEYS, BEFORE).any()
    assert members_after(MOVES, RESTS).known(KEYS, BEFORE).all()


def test_a_clear_member_of_one_hypothesis_is_none_of_another():
    members = members_after(MOVES)
    np.testing.assert_array_equal(members.known(KEYS, np.array([7, 7, 9, 9, 9, 7])), [1, 1, 0, 1, 1, 0])


def test_clear_members_that_are_gone_are_forgotten_and_the_others_survive_a_restart():
    members = members_after(MOVES)
    members.known(KEYS[:4], BEFORE[:4])
    again = ClearMembers()
    again.load(members.state())
    np.testing.assert_array_equal(again.known(KEYS, BEFORE), [1, 1, 1, 1, 0, 0])
