"""The offset of a source, found, kept and dropped by what the window shows; and a lost body's return."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion.partition import NO_HYPOTHESIS
from comotion.rigid.arrivals import undecided
from comotion.rigid.assignment import OUTLIER
from comotion.rigid.explanations import Offset, View, explained
from comotion.rigid.frames import Frames
from comotion.rigid.kernels.records import ROUND
from comotion.rigid.procrustes import fit_body
from comotion.rigid.subset import Scene

RATE = 15
SIGMA = 0.003
PIVOT = np.zeros(3)
NONE = Offset.none(PIVOT)
SMALL = Offset(np.radians([1.0, -1.0, 1.0]), np.array([0.01, 0.0, -0.01]), PIVOT, 0.02)
WRONG = Offset(np.radians([3.0, -2.0, 2.0]), np.array([0.03, -0.03, 0.02]), PIVOT, 0.05)
# Rows of the reference and of the other source on each of two bodies.
REFERENCE = {1: np.arange(0, 4), 2: np.arange(8, 12)}
OTHER = {1: np.arange(4, 8), 2: np.arange(12, 16)}


def frames_of(y, w, seconds, sigma, dim=3):
    """Rows y [n, F, 3] of white noise with weights [n, F], each of a trajectory of its own."""
    n, variance = len(y), np.full(len(y), sigma**2)
    return Frames(
        dim=dim,
        stamps=(seconds * 1e9).astype(np.int64),
        y=y,
        w=w,
        owner=np.arange(n),
        weight=np.ones(n),
        noise=variance,
        tolerance=variance,
        moved=variance,
        metric=np.tile(ROUND, (n, 1)),
        spectrum=np.tile([1.0, 0.0, 0.0], (n, 1)),
        key=np.arange(n),
        life=np.full(n, seconds[-1] + 1 / RATE),
        current=np.ones(n, bool),
    )


def view_of(seconds, groups=OTHER, *, seen=NONE, seed=0, dim=3):
    """Two bodies that two sources see; the second one as if `seen` had been its offset."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    y = np.zeros((16, len(t), 3))
    for k, mine in REFERENCE.items():
        local, home = rng.uniform(-0.2, 0.2, (8, 3)), rng.uniform(-0.6, 0.6, 3)
        spin, way, phase = rng.normal(0, 0.8, 3), rng.normal(0, 0.2, 3), rng.uniform(0, 6, 3)
        if dim == 2:
            local[:, 2] = home[2] = way[2] = 0.0
            spin[:2] = 0.0
        for row, b in zip([*mine, *OTHER[k]], local, strict=True):
            wave = np.sin(1.5 * (t - seen.delay * (row in OTHER[k]))[:, None] + phase)
            y[row] = Rotation.from_rotvec(spin * wave).apply(b) + home + way * wave
        R, shift = seen.transform()
        y[OTHER[k]] = y[OTHER[k]] @ R.T + shift
    y[:, :, :dim] += rng.normal(0, SIGMA, (16, len(t), dim))
    frames = frames_of(y, np.ones(y.shape[:2]), t, SIGMA, dim)
    return View(frames, groups, {k: fit_body(frames, rows) for k, rows in REFERENCE.items()}, 0.6)


@pytest.mark.parametrize("seed", [0, 4])
def test_an_offset_and_a_delay_are_found(seed):
    found = explained(view_of(6.0, seen=SMALL, seed=seed), NONE)
    np.testing.assert_allclose(np.degrees(found.rotation + SMALL.rotation), 0, atol=0.4)
    np.testing.assert_allclose(found.delay, -SMALL.delay, atol=0.005)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("delay", [-0.3, 0.15, 0.4])
def test_the_latency_of_a_source_that_stamps_late_is_found_and_kept(delay, dim):
    view = view_of(8.0, seen=replace(NONE, delay=delay), dim=dim)
    found = explained(view, NONE)
    np.testing.assert_allclose(found.delay, -delay, atol=0.02)
    # As the next frames have it, corrected.
    again = explained(view_of(8.0, dim=dim), found)
    np.testing.assert_allclose(again.delay, found.delay, atol=0.01)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("seconds", [0.7, 6.0])
def test_there_is_no_offset_without_evidence_for_one(seconds, dim):
    assert not explained(view_of(seconds, dim=dim), NONE).vector.any()


@pytest.mark.parametrize("labels", [(1, 2), (6, 7)], ids=["in one hypothesis", "fallen apart"])
def test_a_wrong_offset_is_dropped_within_two_seconds_of_motion(labels):
    groups = dict(zip(labels, OTHER.values(), strict=True))
    found = explained(view_of(2.0, groups, seen=WRONG), WRONG)
    assert (np.abs(found.vector) < 0.2 * np.abs(WRONG.vector)).all()


def test_an_offset_stays_where_no_group_moves_like_a_body():
    kept = explained(view_of(6.0, {3: np.concatenate([OTHER[1], OTHER[2]])}), WRONG)
    np.testing.assert_allclose(kept.vector, WRONG.vector)


OLD, GONE, NEW = slice(0, 10), slice(10, 14), slice(14, 20)


def scene(*, lost: bool, crowded: bool = True) -> Scene:
    """Ten features at rest, four of hypothesis 2 that ended, and six that were born just now."""
    rng = np.random.default_rng(0)
    n, count = 20, 30
    w = np.zeros((n, count))
    w[OLD], w[GONE, :15], w[NEW, -2:] = 1, 1, 1
    places = rng.uniform(-1, 1, (n, 3))
    places[NEW] = rng.uniform(-0.01, 0.01, (6, 3)) if crowded else places[:6] + 0.001
    current, before = np.ones(n, bool), np.full(n, 1)
    current[GONE], before[GONE], before[NEW] = False, 2, NO_HYPOTHESIS
    if not lost:
        before[0] = 2
    frames = frames_of(np.repeat(places[:, None], count, 1), w, np.arange(count) / 15, 1e-3)
    frames = replace(frames, life=(w > 0).sum(1) / 15, current=current)
    nobody = np.zeros(n, bool)
    return Scene(frames, places, frames.life >= 0.3, before, 1, nobody, nobody, nobody)


@pytest.mark.parametrize("nearest", [0, 1])
def test_a_crowd_of_newborn_features_is_undecided_while_a_body_is_lost(nearest):
    labels = undecided(scene(lost=True), np.full(20, nearest))
    assert (labels[NEW] == OUTLIER).all()
    assert (labels[:14] == nearest).all()


def test_without_a_lost_body_and_apart_from_each_other_their_place_decides():
    nothing = np.zeros(20, np.intp)
    assert (undecided(scene(lost=False), nothing) == 0).all()
    assert (undecided(scene(lost=True, crowded=False), nothing) == 0).all()
