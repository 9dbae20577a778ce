"""The compiled code of the pixel method against its readable twins."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from comotion.pixels import key_frames
from comotion.pixels.kernels import affine

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
