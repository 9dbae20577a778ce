"""The compiled code of the pixel method against its readable twins."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from comotion.pixels.kernels import affine, epipolar, linkage, motion, robust_affine, similarity

from ..reference import pixels as twin

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)
few = settings(max_examples=15)
CLOSE = {"rtol": 2e-3, "atol": 2e-3}


def observed(rng, frames=6, count=30):
    """Positions [F, N, 2] of trajectories that drift, and which are visible."""
    x = rng.uniform(0, 300, (1, count, 2)) + np.cumsum(rng.normal(0, 2, (frames, count, 2)), axis=0)
    visible = rng.random((frames, count)) > 0.2
    return np.where(visible[..., None], x, 0).astype(np.float32), visible


def frame_pairs(rng, count=30):
    positions, visible = observed(rng, count=count)
    first, second = np.arange(4), np.arange(4) + 2
    return affine.pair_displacements(positions, visible, first, second)


def symmetric(rng, count, low=0.0):
    matrix = np.triu(rng.uniform(low, 1, (count, count)), 1)
    return (matrix + matrix.T + np.eye(count)).astype(np.float32)


@few
@given(rng=seeds)
def test_local_motions_and_their_residuals(rng):
    pairs = frame_pairs(rng)
    members = rng.integers(0, 30, (8, 11))
    motions, used = affine.fit_local_motions(*pairs, members, 25.0)
    want, wanted = twin.fit_local_motions(*(p.astype(float) for p in pairs), members, 25.0)
    assert_array_equal(used, wanted)
    assert_allclose(motions, want, **CLOSE)
    caps = used * np.float32(400)
    total, activity = (
        affine.total_residuals(*pairs, motions, caps),
        affine.pair_activity(*pairs, motions, caps),
    )
    assert_allclose(total, twin.total_residuals(*pairs, motions, caps), **CLOSE)
    assert_allclose(activity, twin.pair_activity(*pairs, motions, caps), **CLOSE)


@few
@given(rng=seeds)
def test_preference_kernel(rng):
    pattern = rng.integers(0, 3, 20)
    total, count = rng.gamma(1, 4, (20, 9)).astype(np.float32), rng.integers(0, 4, (3, 9)).astype(np.float32)
    want = twin.mean_residuals(total, count, pattern)
    similarity.mean_residuals(total, count, pattern)
    assert_allclose(total, want, rtol=1e-6)
    preferred = (rng.random((20, 9)) ** 12).astype(np.float32)
    coverage = rng.random((3, 9)).astype(np.float32)
    weighted, squares = twin.weigh_preferences(preferred, coverage, pattern)
    assert_allclose(similarity.weigh_preferences(preferred, coverage, pattern), squares, rtol=1e-5)
    assert_allclose(preferred, weighted, rtol=1e-6)


@few
@given(rng=seeds, count=st.sampled_from([1, 7, 70]))
def test_tanimoto_kernel(rng, count):
    pattern = rng.integers(0, 4, count)
    both, own = np.triu(rng.random((count, count))), rng.uniform(2, 3, (count, 4))
    both, own, covered = both.astype(np.float32), own.astype(np.float32), symmetric(rng, 4)
    want = twin.tanimoto(both, own, covered, pattern, 0.0005)
    evidence = np.empty_like(both)
    similarity.tanimoto(both, evidence, own, covered, pattern, np.float32(0.0005))
    assert_allclose(both, want[0], rtol=1e-5)
    assert_allclose(evidence, want[1], rtol=1e-6)
    assert_array_equal(both, both.T)


@few
@given(rng=seeds, count=st.integers(1, 12), least=st.floats(0.05, 0.9))
def test_average_linkage(rng, count, least):
    value, evidence = symmetric(rng, count), symmetric(rng, count, 0.1)
    sums = linkage.pair_sums(value, evidence)
    assert_allclose(sums, twin.pair_sums(value, evidence))
    want = twin.average_linkage(sums.astype(float), least)
    roots = linkage.average_linkage(sums, np.float32(least))
    assert sorted(np.flatnonzero(roots == r).tolist() for r in np.unique(roots)) == want
    labels = rng.integers(0, 3, count)
    found = linkage.sum_over_groups(value, evidence, labels, 3)
    for some, wanted in zip(found, twin.sum_over_groups(value, evidence, labels, 3), strict=True):
        assert_allclose(some, wanted, rtol=1e-6)


@few
@given(rng=seeds)
def test_epipolar_residuals(rng):
    points = rng.uniform([-2, -1, 3], [2, 1, 8], (40, 3))
    x = 500 * points[:, :2] / points[:, 2:] + rng.normal(0, 0.3, (40, 2))
    points += [0.2, 0.05, 0.1]
    y = 500 * points[:, :2] / points[:, 2:] + rng.normal(0, 0.3, (40, 2))
    y[:5] += 4
    assert_allclose(epipolar.residual_alone(x, y), twin.residual_alone(x, y), rtol=1e-3)
    halves = x[:12], y[:12], x[12:], y[12:]
    assert_allclose(epipolar.residuals_joint(*halves), twin.residuals_joint(*halves), rtol=1e-3)
    alone = robust_affine.affine_residual_alone(x, y)
    assert_allclose(alone, twin.affine_residual_alone(x, y), rtol=1e-3)
    joint = robust_affine.affine_residuals_joint(*halves)
    assert_allclose(joint, twin.affine_residuals_joint(*halves), rtol=1e-3)


@few
@given(rng=seeds, members=st.integers(0, 30))
def test_gain_under_the_motion_of_a_group(rng, members):
    place = rng.uniform(0, 300, (40, 2))
    turned = np.stack([0.02 * place[:, ::-1] * [1, -1], 0.04 * place[:, ::-1] * [1, -1]])
    arguments = (
        place,
        turned + rng.normal(0, 0.5, turned.shape),
        rng.random((2, 40)) > 0.2,
        rng.uniform(0.01, 1.0, 40),
        np.array([0.3, 0.45]),
        np.arange(40) < members,
    )
    (gain, far), (expected, farther) = motion.motion_gain(*arguments), twin.motion_gain(*arguments)
    assert_allclose(gain, expected, atol=1e-7)
    assert_allclose(far, farther, rtol=1e-9)
