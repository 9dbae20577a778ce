"""The compiled code of the pixel method against its readable twins."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from comotion.pixels.kernels import affine, epipolar, linkage, motion, neighbours, robust_affine, similarity

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
def test_displacements_over_frame_pairs(rng):
    arguments = *observed(rng), np.array([0, 1, 2]), np.array([1, 3, 5])
    for found, want in zip(
        affine.pair_displacements(*arguments), twin.pair_displacements(*arguments), strict=True
    ):
        assert_array_equal(found, want)


@few
@given(rng=seeds, ridge=st.floats(1.0, 100.0))
def test_affine_fit(rng, ridge):
    x, y, u, v = rng.normal(0, 20, (4, 9, 3))
    w = rng.uniform(0, 1, (9, 3))
    means, normal, fields = affine.fit_affine(x, y, u, v, w, ridge)
    for h in range(3):
        centre, matrix, field = twin.fit_affine(x[:, h], y[:, h], u[:, h], v[:, h], w[:, h], ridge)
        assert_allclose(means[1:3, h], centre, atol=1e-9)
        assert_allclose(normal[:, h], [matrix[0, 0], matrix[1, 1], matrix[0, 1]], rtol=1e-9, atol=1e-9)
        assert_allclose(fields[:, h], field, rtol=1e-8, atol=1e-8)


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
@given(rng=seeds, ranks=st.sampled_from([(2, 3, 4, 5), (3,), (1, 4)]))
def test_shape_interaction(rng, ranks):
    preference, vectors = symmetric(rng, 8), rng.normal(size=(5, 8)).astype(np.float32)
    vectors[:, 0] = 0
    floors = 0.001, 0.01, 0.001
    want = twin.combine_kernels(preference.astype(float), vectors.astype(float), ranks, *floors)
    similarity.combine_kernels(preference, vectors, np.array(ranks), *(np.float32(f) for f in floors))
    assert_allclose(preference, want, rtol=1e-3)
    assert_array_equal(preference, preference.T)


@few
@given(rng=seeds)
def test_neighbour_distances(rng):
    positions, visible = observed(rng)
    seen = visible.astype(np.float32)
    assert_allclose(
        neighbours.centred_terms(positions, seen), twin.centred_terms(positions, seen), rtol=1e-3, atol=0.1
    )
    place, motion = rng.normal(5, 4, (2, 3, 9)).astype(np.float32)
    both, moving = rng.integers(0, 5, (2, 3, 9)).astype(np.float32)
    want = twin.combine_distances(place, both, motion, moving, 10, 6)
    neighbours.combine_distances(place, both, motion, moving, np.float32(10), np.float32(6))
    assert_allclose(place, want, rtol=1e-5)


@few
@given(rng=seeds, levels=st.sampled_from([3, 1000]))
def test_members_are_drawn_from_the_nearest(rng, levels):
    # With few levels many distances are equal.
    distance = rng.integers(0, levels, (4, 20)).astype(np.float32)
    seeds_, lots = rng.integers(0, 20, 4), rng.random((4, 7))
    distance[np.arange(4), seeds_] = -1
    near = neighbours.within_limits(distance, np.sort(distance, axis=1)[:, 9], 10)
    assert_array_equal(near, twin.within_limits(distance, 10))
    want, picks = twin.pick_members(distance, near, seeds_, lots, 5), np.empty((4, 5), np.intp)
    neighbours.pick_members(distance, near, seeds_, lots, picks)
    assert_array_equal(picks, want)
    assert_array_equal(neighbours.smallest(distance[0], 6), twin.smallest(distance[0], 6))


@few
@given(rng=seeds)
def test_similarity_to_the_nearest_of_a_group(rng):
    positions, visible = observed(rng, frames=3, count=20)
    arguments = positions.transpose(0, 2, 1).copy(), visible.astype(np.float32), symmetric(rng, 20)
    for others in (np.arange(8), np.arange(8, 20)):
        found = neighbours.similarity_to_nearest(*arguments, np.arange(8), others, 5)
        want = twin.similarity_to_nearest(*arguments, np.arange(8), others, 5)
        for some, wanted in zip(found, want, strict=True):
            assert_allclose(some, wanted, rtol=1e-4)


@few
@given(rng=seeds)
def test_newborn_trajectories(rng):
    positions, valid = rng.normal(0, 20, (5, 9, 2)), rng.random((5, 9)) > 0.4
    owner = np.repeat([0, 1, 2], [3, 1, 2])
    instant = np.array([0, 1, 2, 4, 2, 3])
    arguments = positions, valid, rng.normal(0, 20, (6, 2)), instant, owner, 3, 10.0
    distance = neighbours.newborn_distances(*arguments)
    assert_allclose(distance, twin.newborn_distances(*arguments), rtol=1e-9)
    labels, previous = rng.integers(1, 4, 9), rng.integers(-1, 4, 3)
    found, share = neighbours.weighted_votes(distance, labels, previous, 5, 1.0)
    want, wanted = twin.weighted_votes(distance, labels, previous, 5, 1.0)
    assert_array_equal(found, want)
    assert_allclose(share, wanted)


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
