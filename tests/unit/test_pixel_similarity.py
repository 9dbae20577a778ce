"""How trajectories of a space in pixels are compared."""

import numpy as np

from comotion.pixels.affine import Residuals
from comotion.pixels.similarity import preference, visibility_patterns


def test_preference_is_the_tanimoto_kernel_of_preferred_motions():
    rng = np.random.default_rng(3)
    seen = (rng.random((6, 14)) > 0.3).astype(np.float32)
    # Few ways in which motions and trajectories are used and seen, as in a recording.
    seen[:, 5:] = seen[:, rng.integers(0, 5, 9)]
    used = (rng.random((3, 6)) > 0.3).astype(np.float32)[rng.integers(0, 3, 40)]
    total = rng.gamma(0.5, 4.0, (40, 14)).astype(np.float32)
    activity = rng.random(6)
    count = used @ seen
    square = np.where(count > 0, total / np.maximum(count, 1), np.inf)
    width = 2 * (32.0 * np.median(square.min(axis=0)) + 0.05)
    phi, cover = np.exp(-square / width), ((used * activity / activity.sum()) @ seen) ** 3
    found = preference(Residuals(total.copy(), used, activity), seen)
    for i in range(14):
        for j in range(14):
            c, a, b = cover[:, i] * cover[:, j], phi[:, i], phi[:, j]
            expected = (c * a * b).sum() / (c * (a * a + b * b - a * b)).sum()
            assert abs(found.value[i, j] - expected) < 1e-5
            covered = (cover[::4, i] * cover[::4, j]).mean() + 0.0005
            assert abs(found.evidence[i, j] - covered) < 1e-6
    np.testing.assert_allclose(found.residual, square.min(axis=0), rtol=1e-6)


def test_equal_rows_have_one_visibility_pattern():
    rows = np.array([[1, 0, 1], [0, 0, 1], [1, 0, 1], [0, 0, 1], [1, 1, 1]])
    first, of = visibility_patterns(rows)
    np.testing.assert_array_equal(rows[first][of], rows)
    assert len(first) == 3
    assert len(visibility_patterns(np.zeros((4, 0))).first) == 1
