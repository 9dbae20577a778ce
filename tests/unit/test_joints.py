"""Joints: fits of the models, the choice of a kind, memory, and joints in updates."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion import Fusion, FusionConfig
from comotion.config import JointsConfig
from comotion.joints.joints import Joints
from comotion.joints.models import first_guess, fit
from comotion.joints.pair import Pair
from comotion.joints.states import relative_states
from comotion.partition import BodyMotion
from comotion_schemas import decode, encode

from ..builders import batch, play, restored

TURN_NOISE, SHIFT_NOISE = np.radians(0.64), 0.0015
FRAME_NS = 1_000_000_000 // 15


def motion(R, t, *, static=False, start=0):
    count = len(R)
    covariance = np.eye(3) * (0.0 if static else TURN_NOISE**2)
    return BodyMotion(
        stamps=(start + np.arange(count)) * FRAME_NS,
        R=R,
        t=t,
        posed=np.ones(count, bool),
        turn_covariance=np.tile(covariance, (count, 1, 1)),
        place_variance=np.full(count, 0.0 if static else SHIFT_NOISE**2),
        centre=np.zeros(3),
        radius=0.0 if static else 0.1,
        static=static,
    )


def world(count, start=0):
    return motion(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)), static=True, start=start)


AXIS = np.array([0.0, 0.6, 0.8])
HINGE = np.array([0.4, 0.1, 0.2])


def child(kind, q, seed=0, start=0):
    """A body that moves by positions q on a hinge or a slide, with the noise of a pose."""
    rng, q = np.random.default_rng(seed), np.asarray(q)
    R0, p0 = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), np.array([0.6, 0.3, 0.1])
    E = Rotation.from_rotvec(q[:, None] * AXIS * (kind == "revolute")).as_matrix()
    p = HINGE + E @ (p0 - HINGE) + q[:, None] * AXIS * (kind == "prismatic")
    R = Rotation.from_rotvec(rng.normal(0, TURN_NOISE, (len(q), 3))).as_matrix() @ E @ R0
    return motion(R, p + rng.normal(0, SHIFT_NOISE, p.shape), start=start)


def judged(body, *, times=2):
    pair = Pair.of(1, 2, "world", np.zeros(3))
    for _ in range(times):
        pair.judge(world(len(body.stamps), int(body.stamps[0] // FRAME_NS)), body)
    return pair


@pytest.mark.parametrize(
    ("kind", "reach"),
    [("revolute", np.radians(20)), ("revolute", 1.5), ("prismatic", 0.05), ("prismatic", 0.3)],
)
def test_the_kind_is_known_once_it_has_moved(kind, reach):
    right = 0
    for seed in range(5):
        pair = judged(child(kind, np.linspace(0, reach, 60), seed))
        right += pair.joint.kind == kind
        assert np.degrees(np.arccos(abs(pair.models[kind].u @ AXIS))) < 3
    assert right == 5


@pytest.mark.parametrize(("kind", "reach"), [("revolute", np.radians(4)), ("prismatic", 0.008)])
def test_what_has_hardly_moved_is_undetermined(kind, reach):
    for seed in range(5):
        assert judged(child(kind, np.linspace(0, reach, 60), seed)).joint.kind == "undetermined"


def test_a_body_that_drifts_off_is_free():
    t = np.linspace(0, 4, 60)
    R = Rotation.from_rotvec(np.column_stack([np.sin(t), 0.3 * t, np.cos(2 * t)])).as_matrix()
    body = motion(R, np.column_stack([0.2 * t, 0.1 * np.sin(2 * t), 0.05 * t**2]))
    assert judged(body).joint.kind == "free"


def test_bodies_that_move_as_one_are_fixed():
    t = np.linspace(0, 3, 45)
    R = Rotation.from_rotvec(np.column_stack([0.3 * t, 0 * t, 0 * t])).as_matrix()
    carrier = motion(R, np.column_stack([0.1 * t, 0 * t, 0 * t]))
    rng = np.random.default_rng(0)
    held_R = Rotation.from_rotvec(rng.normal(0, TURN_NOISE, (45, 3))).as_matrix() @ R
    held = motion(held_R, R @ [0.2, 0, 0] + carrier.t + rng.normal(0, SHIFT_NOISE, (45, 3)))
    pair = Pair.of(1, 2, "world", np.zeros(3))
    for _ in range(2):
        pair.judge(carrier, held)
    assert pair.joint.kind == "fixed"


def test_a_joint_is_remembered_when_its_motion_has_left_the_window(monkeypatch):
    pair = Pair.of(1, 2, "world", np.zeros(3))
    monkeypatch.setattr("comotion.joints.states._MAX_STATES", 10)
    for first in range(0, 400, 15):
        q = np.clip((np.arange(first, first + 150) - 100) * 0.02, 0, 1.2)
        pair.judge(world(150, first), child("revolute", q, seed=first, start=first))
    assert pair.joint.kind == "revolute"
    assert len(pair._keys) <= 10
    # For the last 150 frames it has rested.
    low, high = pair.range
    assert high - low == pytest.approx(1.2, abs=0.1)


def test_a_joint_that_breaks_is_released():
    q = np.linspace(0, 1.2, 150)
    pair = judged(child("revolute", q))
    assert pair.joint.kind == "revolute"
    body = child("revolute", np.concatenate([q[30:], np.full(30, 1.2)]), start=30)
    body.t[-30:] += np.linspace(0, 0.3, 30)[:, None] * np.array([1.0, 1.0, -1.0])
    pair.judge(world(150, 30), body)
    assert pair.joint.kind in {"undetermined", "free"}


def test_a_fit_that_is_hopeless_goes_on_at_the_next_judgement():
    body = child("revolute", np.linspace(0, 1.2, 60))
    states = relative_states(world(60), body, np.zeros(3))
    model = replace(first_guess(states, "revolute"), u=np.array([1.0, 0, 0]), c=1.5 * HINGE)
    worst = fit(states, model, 1.0, steps=0).misfit
    for _ in range(20):
        fitted = fit(states, model, 1.0)
        model = fitted.model
    assert fitted.misfit < worst / 20
    assert abs(model.u @ AXIS) > 0.99


def test_every_pair_has_its_turn():
    joints, near = Joints(JointsConfig(pairs=1)), [(1, 2), (3, 4)]
    due = [joints._due(near, k * 200_000_000) for k in range(3)]
    assert due == [[(1, 2)], [(3, 4)], [(1, 2)]]
    assert joints._due(near, 400_000_000) == []


@pytest.fixture(scope="module")
def door():
    """Updates of a door that opens by 69 degrees in 3 s, and the fusion after them."""
    rng = np.random.default_rng(3)
    wall = rng.uniform([-1, -0.2, 0], [1, 0.2, 1], (25, 3))
    leaf = rng.uniform([0, 0, 0], [0.4, 0.02, 0.6], (14, 3))

    def seen(k, now):
        angle = 1.2 * np.clip(k / 15 - 1, 0, 3) / 3
        turned = leaf @ Rotation.from_rotvec([0, 0, angle]).as_matrix().T
        return batch("cam", k, now, np.vstack([wall, turned]) + rng.normal(0, 0.002, (39, 3)))

    fusion = Fusion(FusionConfig(window=5.0))
    return fusion, play(fusion, range(75), seen, rate=15, every=3)


def test_updates_say_that_a_door_turns_about_its_hinge(door):
    _, updates = door
    (joint,) = decode(encode(updates[-1])).joints
    assert joint.kind == "revolute"
    assert abs(joint.axis[2]) > 0.999
    assert np.linalg.norm(joint.point[:2]) < 0.01
    assert joint.upper - joint.lower == pytest.approx(1.2, abs=0.1)
    opening = next(u.joints[0] for u in updates if u.joints and u.joints[0].kind == "revolute")
    assert opening.rate * opening.axis[2] == pytest.approx(0.4, abs=0.1)
    events = {(e.kind, e.hypothesis, *e.others) for u in updates for e in u.events}
    assert ("joined", joint.parent, joint.child) in events


def test_a_restart_keeps_the_joint(door):
    fusion, updates = door
    (joint,) = restored(fusion, clean=True).update(updates[-1].published_ns).joints
    assert joint.kind == "revolute"
    assert joint.position == pytest.approx(updates[-1].joints[0].position, abs=0.05)
