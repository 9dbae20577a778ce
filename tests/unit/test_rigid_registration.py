"""The offset of a source: found, kept, and dropped by what the window shows."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion.rigid.explanations import Offset, View, explained
from comotion.rigid.kernels.records import ROUND, RowArrays
from comotion.rigid.kernels.registration import pose_information
from comotion.rigid.procrustes import align, fit_body
from comotion.rigid.resampling import Frames

RATE = 15
SIGMA = 0.003
PIVOT = np.zeros(3)
NONE = Offset.none(PIVOT)
WRONG = Offset(np.radians([3.0, -2.0, 2.0]), np.array([0.03, -0.03, 0.02]), PIVOT, 0.05)
# Rows of the reference and of the other source on each of two bodies.
REFERENCE = {1: np.arange(0, 4), 2: np.arange(8, 12)}
OTHER = {1: np.arange(4, 8), 2: np.arange(12, 16)}


def frames_of(seconds, seen=NONE, moving=1.0, seed=0, dim=3):
    """Two bodies that two sources see; the second one as if `seen` had been its offset."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    y = np.zeros((16, len(t), 3))
    for rows in (np.arange(8), np.arange(8, 16)):
        local, home = rng.uniform(-0.2, 0.2, (8, 3)), rng.uniform(-0.6, 0.6, 3)
        spin, way, phase = rng.normal(0, 0.8, 3), rng.normal(0, 0.2, 3), rng.uniform(0, 6, 3)
        if dim == 2:
            local[:, 2] = home[2] = way[2] = 0.0
            spin[:2] = 0.0
        late = np.where(np.isin(rows, [*OTHER[1], *OTHER[2]]), seen.delay, 0.0)
        for row, b, delay in zip(rows, local, late, strict=True):
            wave = moving * np.sin(1.5 * (t - delay)[:, None] + phase)
            y[row] = Rotation.from_rotvec(spin * wave).apply(b) + home + way * wave
    R, shift = seen.transform()
    for rows in OTHER.values():
        y[rows] = y[rows] @ R.T + shift
    y[:, :, :dim] += rng.normal(0, SIGMA, (16, len(t), dim))
    variance, n = np.full(16, SIGMA**2), len(t)
    return Frames(
        dim=dim, stamps=(t * 1e9).astype(np.int64), y=y, w=np.ones((16, n)), owner=np.arange(16),
        weight=np.ones(16), noise=variance, tolerance=variance, metric=np.tile(ROUND, (16, 1)),
        spectrum=np.tile([1.0, 0.0, 0.0], (16, 1)),
        key=np.arange(16), life=np.full(16, n / 15), current=np.ones(16, bool),
    )  # fmt: skip


def view_of(frames, groups=OTHER):
    return View(frames, groups, {k: fit_body(frames, rows) for k, rows in REFERENCE.items()}, 0.6)


def inverse(offset):
    return Offset(-offset.rotation, -offset.shift, PIVOT, -offset.delay)


@pytest.mark.parametrize("seed", range(0, 10, 2))
@pytest.mark.parametrize("seconds", [0.7, 2.0, 6.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_no_offset_stays_in_force_without_evidence_for_one(seed, seconds, dim):
    assert not explained(view_of(frames_of(seconds, seed=seed, dim=dim)), NONE).vector.any()


@pytest.mark.parametrize("seed", range(0, 10, 2))
@pytest.mark.parametrize("split", [False, True])
def test_a_wrong_offset_is_dropped_within_two_seconds_of_motion(seed, split):
    groups = {k + 5: rows for k, rows in OTHER.items()} if split else OTHER
    found = explained(view_of(frames_of(2.0, WRONG, seed=seed), groups), WRONG)
    assert (np.abs(found.vector) < 0.2 * np.abs(WRONG.vector)).all()


@pytest.mark.parametrize("seed", range(0, 10, 2))
def test_a_real_offset_is_found(seed):
    error = Offset(np.radians([1.0, -1.0, 1.0]), np.array([0.01, 0.0, -0.01]), PIVOT, 0.02)
    offset = explained(view_of(frames_of(6.0, error, seed=seed)), NONE)
    np.testing.assert_allclose(np.degrees(offset.rotation + error.rotation), 0, atol=0.4)
    np.testing.assert_allclose(offset.delay, -error.delay, atol=0.005)


def test_an_offset_stays_where_no_group_moves_like_a_body():
    before, groups = inverse(WRONG), {3: np.concatenate([OTHER[1], OTHER[2]])}
    kept = explained(view_of(frames_of(6.0), groups), before)
    np.testing.assert_allclose(kept.vector, before.vector)


def test_the_information_of_poses_is_that_of_fitted_ones():
    rng = np.random.default_rng(2)
    template, sigma = rng.uniform(-0.1, 0.1, (9, 3)), 0.003
    template -= template.mean(0)
    metric, spectrum = np.tile(ROUND, (9, 1)), np.tile([1.0, 0.0, 0.0], (9, 1))
    arrays = RowArrays(np.zeros((9, 1, 3)), np.ones((9, 1)), np.full(9, sigma**2), spectrum, metric)
    information = np.zeros((1, 6, 6))
    pose_information(arrays, np.arange(9), template, 3, information)
    fitted = [align(template, template + rng.normal(0, sigma, template.shape), 3) for _ in range(400)]
    errors = np.array([[*Rotation.from_matrix(R).as_rotvec(), *t] for R, t in fitted])
    expected = np.diag(np.linalg.inv(information[0]))
    np.testing.assert_allclose((errors**2).mean(0), expected, rtol=0.3)
