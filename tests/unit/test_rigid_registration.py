"""The offset of a source from the reference: found, kept, and dropped by what the window shows."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion.rigid.explanations import Offset, View, explained
from comotion.rigid.kernels.records import ROUND
from comotion.rigid.procrustes import align, fit_body, pose_information
from comotion.rigid.resampling import Frames

RATE = 15
SIGMA = 0.003
PIVOT = np.zeros(3)
NONE = Offset.none(PIVOT)
SMALL = Offset(np.radians([1.0, -1.0, 1.0]), np.array([0.01, 0.0, -0.01]), PIVOT, 0.02)
WRONG = Offset(np.radians([3.0, -2.0, 2.0]), np.array([0.03, -0.03, 0.02]), PIVOT, 0.05)
# Rows of the reference and of the other source on each of two bodies.
REFERENCE = {1: np.arange(0, 4), 2: np.arange(8, 12)}
OTHER = {1: np.arange(4, 8), 2: np.arange(12, 16)}


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
    variance, spectrum = np.full(16, SIGMA**2), np.tile([1.0, 0.0, 0.0], (16, 1))
    frames = Frames(
        dim=dim, stamps=(t * 1e9).astype(np.int64), y=y, w=np.ones(y.shape[:2]), owner=np.arange(16),
        weight=np.ones(16), noise=variance, tolerance=variance, metric=np.tile(ROUND, (16, 1)),
        spectrum=spectrum, key=np.arange(16), life=np.full(16, seconds), current=np.ones(16, bool),
    )  # fmt: skip
    return View(frames, groups, {k: fit_body(frames, rows) for k, rows in REFERENCE.items()}, 0.6)


@pytest.mark.parametrize("seed", [0, 4])
def test_an_offset_and_a_delay_are_found(seed):
    found = explained(view_of(6.0, seen=SMALL, seed=seed), NONE)
    np.testing.assert_allclose(np.degrees(found.rotation + SMALL.rotation), 0, atol=0.4)
    np.testing.assert_allclose(found.delay, -SMALL.delay, atol=0.005)


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


def test_the_information_of_poses_is_that_of_fitted_ones():
    rng = np.random.default_rng(2)
    template = rng.uniform(-0.1, 0.1, (9, 3))
    template -= template.mean(0)
    frames = view_of(1.0).frames
    information = pose_information(frames, np.arange(9), template, np.full(9, SIGMA**2))
    fitted = [align(template, template + rng.normal(0, SIGMA, template.shape), 3) for _ in range(400)]
    errors = np.array([[*Rotation.from_matrix(R).as_rotvec(), *t] for R, t in fitted])
    expected = np.diag(np.linalg.inv(information[0]))
    np.testing.assert_allclose((errors**2).mean(0), expected, rtol=0.3)
