"""The compiled code of the pixel method against its readable twins."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from comotion.pixels import key_frames
from comotion.pixels.distances import distances
from comotion.pixels.kernels import affine, motion

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
    pairs = key_frames.frame_pairs(key_frames.KeyFrames(positions, visible, np.zeros(count)), (2,))
    return pairs.start, pairs.displacement, pairs.seen


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
    total = affine.total_residuals(*pairs, motions, caps)
    assert_allclose(total, twin.total_residuals(*pairs, motions, caps), **CLOSE)


@few
@given(rng=seeds)
def test_distances_over_common_frames(rng):
    positions, visible = observed(rng)
    found = distances(key_frames.KeyFrames(positions, visible, np.zeros(30)))
    for i, j in [(0, 1), (5, 20), (29, 3)]:
        both = visible[:, i] & visible[:, j]
        if both.sum() < 2:
            assert np.isinf(found.image[i, j])
            continue
        apart = (positions[both, i] - positions[both, j]) ** 2
        assert_allclose(found.image[i, j], np.sqrt(apart.sum(axis=1).mean()), rtol=1e-3)
        moves = np.diff(positions[:, i] - positions[:, j], axis=0)[both[1:] & both[:-1]]
        moved = np.sqrt((moves**2).sum() / max(len(moves), 1))
        share = np.sqrt(both.mean())
        assert_allclose(found.local[i, j], (found.image[i, j] + 10 * moved) / share, rtol=1e-2)


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
