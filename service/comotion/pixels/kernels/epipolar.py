"""Fits fundamental matrices to points in two frames, and gives the residuals of points under them."""

import numpy as np

from ...arrays import Floats, Ints
from ...compiled import compiled

# Rounds of inverse iteration, and what is added to the diagonal, relative to its mean.
_ROUNDS, _RIDGE = 8, 1e-12


@compiled()
def epipolar_misfits(first: Floats, second: Floats, starts: Ints, picks: Ints) -> Floats:
    """Mean squared Sampson distances, px², of G groups of points under H fundamental matrices, [H, G].

    Of points [n, 2] in both frames, group g from starts[g] up to starts[g + 1]. A matrix is fitted to each
    row of `picks` [H, m], indices of points.
    """
    misfits = np.zeros((len(picks), len(starts) - 1))
    for h in range(len(picks)):
        matrix = fundamental(first[picks[h]], second[picks[h]])
        squares = sampson(matrix, first, second)
        for g in range(len(starts) - 1):
            for i in range(starts[g], starts[g + 1]):
                misfits[h, g] += squares[i]
            misfits[h, g] /= max(starts[g + 1] - starts[g], 1)
    return misfits


@compiled()
def sampson(f: Floats, first: Floats, second: Floats) -> Floats:
    """Squared Sampson distances of points [n, 2] in both frames under a fundamental matrix, px² [n]."""
    squares = np.empty(len(first))
    for i in range(len(first)):
        x, y, u, v = first[i, 0], first[i, 1], second[i, 0], second[i, 1]
        a = f[0, 0] * x + f[0, 1] * y + f[0, 2]
        b = f[1, 0] * x + f[1, 1] * y + f[1, 2]
        c = f[2, 0] * x + f[2, 1] * y + f[2, 2]
        d = f[0, 0] * u + f[1, 0] * v + f[2, 0]
        e = f[0, 1] * u + f[1, 1] * v + f[2, 1]
        squares[i] = (u * a + v * b + c) ** 2 / max(a * a + b * b + d * d + e * e, 1e-12)
    return squares


@compiled()
def fundamental(first: Floats, second: Floats) -> Floats:
    """Fundamental matrix [3, 3] of points [m, 2] in both frames, by the eight-point method (Hartley 1997)."""
    left, right = _normalising(first), _normalising(second)
    rows = np.ones((len(first), 9))
    x, y = left[0, 0] * first[:, 0] + left[0, 2], left[1, 1] * first[:, 1] + left[1, 2]
    u, v = right[0, 0] * second[:, 0] + right[0, 2], right[1, 1] * second[:, 1] + right[1, 2]
    rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = u * x, u * y, u, v * x
    rows[:, 4], rows[:, 5], rows[:, 6], rows[:, 7] = v * y, v, x, y
    normal = rows.T @ rows
    inverse = np.linalg.inv(normal + _RIDGE * np.trace(normal) * np.eye(9))
    vector = np.ones(9)
    for _ in range(_ROUNDS):
        vector = inverse @ vector
        vector /= np.sqrt((vector * vector).sum())
    u, s, v = np.linalg.svd(vector.reshape(3, 3))
    s[2] = 0.0
    matrix: Floats = right.T @ (u * s) @ v @ left
    return matrix


@compiled()
def _normalising(points: Floats) -> Floats:
    """Matrix [3, 3] that brings points [m, 2] to mean distance √2 from 0."""
    x, y = points[:, 0].mean(), points[:, 1].mean()
    scale = np.sqrt(2) / max(np.sqrt((points[:, 0] - x) ** 2 + (points[:, 1] - y) ** 2).mean(), 1e-9)
    return np.array([[scale, 0.0, -scale * x], [0.0, scale, -scale * y], [0.0, 0.0, 1.0]])
