"""The box of a hypothesis holds the members ever seen, in the axes of its body."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comotion import Fusion
from comotion.hypotheses.extent import _SMALLER, box_of
from comotion.hypotheses.records import Current, Record
from comotion.partition import PoseReference
from comotion_schemas.rigid import matrix

from ..builders import S, batch, play

HALF = np.array([0.3, 0.2, 0.1])
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * HALF


class Body:
    """Measures one hypothesis whose pose the test sets."""

    def __init__(self, dim=3):
        self.dim, self.record = dim, Record(PoseReference.new(0))
        self.posed, self.reference, self.since = True, self.record.reference, {}

    def move(self, R, t):
        self.reference.R[: self.dim, : self.dim], self.reference.t[: self.dim] = R, t

    def box(self, stamp_ns, points, keys=None, labels=None):
        """Points float64 [n, dim] in the axes of the body."""
        R, t = self.reference.R[: self.dim, : self.dim], self.reference.t[: self.dim]
        count = len(points)
        keys = np.arange(count) if keys is None else np.array(keys)
        labels = np.ones(count, int) if labels is None else np.array(labels)
        since = np.array([self.since.setdefault(key, stamp_ns) for key in keys.tolist()])
        current = Current(keys, np.arange(count), labels, points @ R.T + t, since)
        self.record.see(stamp_ns, 1, current, posed=self.posed)
        return box_of(self.record)


def surface(half):
    a, b, c = half
    return a * b + b * c + a * c


def holds(box, points):
    return (np.abs((points - box.center) @ matrix(box.rotation)) <= np.array(box.half) + 1e-9).all()


@given(turn=st.tuples(*[st.floats(-3, 3)] * 3), shift=st.tuples(*[st.floats(-5, 5)] * 3))
def test_a_cuboid_has_its_own_box_however_it_is_turned(turn, shift):
    body = Body()
    R = Rotation.from_rotvec(turn).as_matrix()
    box = body.box(0, CORNERS @ R.T + shift)
    # The first axes, those of the space, are kept if their box is hardly larger than the smallest.
    assert surface(box.half) <= surface(HALF) / _SMALLER * (1 + 1e-9)
    np.testing.assert_allclose(box.center, shift, atol=0.02)
    assert holds(box, CORNERS @ R.T + shift)


def test_lost_members_stay_and_those_of_others_leave():
    body = Body()
    body.box(0, CORNERS)
    whole = body.box(S // 2, CORNERS)
    body.move(Rotation.from_rotvec([0, 0, 1.0]).as_matrix(), [0.5, 0, 0])
    np.testing.assert_allclose(body.box(S, CORNERS[:4], keys=range(4)).half, whole.half, atol=1e-9)
    taken = body.box(2 * S, CORNERS, labels=[1] * 4 + [2] * 4)
    assert min(taken.half) == pytest.approx(0.0, abs=1e-9)


def test_members_that_are_all_farther_apart_than_those_before_have_a_box():
    body = Body()
    body.box(0, 0.01 * CORNERS)
    np.testing.assert_allclose(body.box(S // 10, CORNERS[[0, 7]], keys=[8, 9]).half, HALF, atol=1e-9)


@pytest.mark.parametrize("count", [6, 400])
def test_a_wrong_member_that_was_lost_does_not_stretch_the_box(count):
    body, rng = Body(), np.random.default_rng(0)
    points = np.vstack([CORNERS, rng.uniform(-HALF, HALF, (count, 3)), [[3.0, 0.0, 0.0]]])
    for stamp_ns in (0, S):
        body.box(stamp_ns, points)
    box = body.box(2 * S, CORNERS, keys=range(8))
    np.testing.assert_allclose(np.sort(box.half), np.sort(HALF), rtol=0.05)


@pytest.mark.parametrize("dim", [2, 3])
def test_without_a_pose_a_box_is_upright_and_moves_with_its_members(dim):
    body, points = Body(dim), np.random.default_rng(0).uniform(100, 160, (12, dim))
    body.posed = False
    first = body.box(0, points)
    assert (matrix(first.rotation) == np.eye(dim)).all()
    assert holds(first, points)
    later = body.box(S // 10, points + 7)
    np.testing.assert_allclose(later.center, np.array(first.center) + 7)
    np.testing.assert_allclose(later.half, first.half)


def test_a_wrong_feature_does_not_make_a_box_cross_the_image():
    body, points = Body(dim=2), np.random.default_rng(0).uniform([100, 100], [160, 130], (12, 2))
    body.posed = False
    alone = body.box(0, points)
    wrong, near = np.vstack([points, [600.0, 115.0]]), np.vstack([points, [190.0, 115.0]])
    for k in range(1, 40):
        box = body.box(k * S // 20, wrong)
    np.testing.assert_allclose(box.half, alone.half, rtol=0.1)
    assert body.box(2 * S, near).half[0] < alone.half[0] + 5
    for k in range(41, 80):
        box = body.box(k * S // 20, near)
    assert holds(replace(box, half=[h * 1.01 for h in box.half]), near)


def test_updates_have_boxes_that_hold_a_body_half_of_which_is_hidden():
    rng = np.random.default_rng(0)
    floor = rng.uniform(-1, 1, (20, 3))
    body = np.vstack([CORNERS, rng.uniform(-HALF, HALF, (8, 3))])

    def moved(k, points):
        return Rotation.from_rotvec([0, 0, 0.02 * k]).apply(points) + np.array([0.01 * k, 0, 0.5])

    def seen(k, now):
        positions = np.vstack([moved(k, body), floor]) + rng.normal(0, 0.001, (36, 3))
        # A face of the body turns out of sight.
        ids = np.arange(36) if k < 70 else np.r_[:4, 8:36]
        return batch("mine", k, now, positions[ids], ids=ids)

    (moving,) = [h for h in play(Fusion(), range(90), seen, every=3)[-1].hypotheses if h.state == "moving"]
    assert moving.size == 12
    larger = replace(moving.box, half=[h + 0.02 for h in moving.box.half])
    assert holds(larger, moved(89, CORNERS[4:8]))
    np.testing.assert_allclose(np.sort(moving.box.half), np.sort(HALF), rtol=0.15)
