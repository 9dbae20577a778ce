"""Fits fundamental matrices to points in two frames, and gives the residuals of points under them."""

import numpy as np

from ...arrays import Floats, Ints
from ...compiled import compiled

# Rounds of inverse iteration, and what is added to the diagonal, relative to its sum.
_ROUNDS, _RIDGE = 8, 1e-12


@compiled()
def epipolar_misfits(first: Floats, second: Floats, starts: Ints, picks: Ints) -> Floats:
    """Mean squared Sampson distances, px², of G groups of points under H fundamental matrices, [H, G].

    Of points [n, 2] in both frames, group g from starts[g] up to starts[g + 1]. A matrix is fitted to each
    row of `picks` [H, m], indices of points.
    """
    misfits = np.zeros((len(picks), len(starts) - 1))
    for h in range(len(picks)):
        squares = sampson(fundamental(first[picks[h]], second[picks[h]]), first, second)
        for g in range(len(starts) - 1):
            misfits[h, g] = squares[starts[g] : starts[g + 1]].mean()
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
    normal, row = np.zeros((9, 9)), np.ones(9)
    for i in range(len(first)):
        x, y = left[0, 0] * first[i, 0] + left[0, 2], left[1, 1] * first[i, 1] + left[1, 2]
        u, v = right[0, 0] * second[i, 0] + right[0, 2], right[1, 1] * second[i, 1] + right[1, 2]
        row[:8] = u * x, u * y, u, v * x, v * y, v, x, y
        for j in range(9):
            for k in range(j + 1):
                normal[j, k] += row[j] * row[k]
    full = _least(normal).reshape(3, 3)
    # Its rank is 2.
    null = _least(full.T @ full)
    for j in range(3):
        full[j] -= (full[j] * null).sum() * null
    matrix: Floats = right.T @ full @ left
    return matrix


@compiled()
def _least(factor: Floats) -> Floats:
    """Unit eigenvector [n] of the least eigenvalue of a positive matrix, of which the lower half is used up.

    By inverse iteration: ten times as fast for such small ones as LAPACK's decompositions.
    """
    ridge, count = _RIDGE * np.trace(factor), len(factor)
    # Cholesky's factor, with the inverse of its diagonal.
    for j in range(count):
        factor[j, j] += ridge
        for k in range(j + 1):
            for other in range(k):
                factor[j, k] -= factor[j, other] * factor[k, other]
            factor[j, k] = factor[j, k] * factor[k, k] if k < j else 1 / np.sqrt(factor[j, j])
    vector = np.ones(count)
    for _ in range(_ROUNDS):
        for j in range(count):
            for k in range(j):
                vector[j] -= factor[j, k] * vector[k]
            vector[j] *= factor[j, j]
        for j in range(count - 1, -1, -1):
            for k in range(j + 1, count):
                vector[j] -= factor[k, j] * vector[k]
            vector[j] *= factor[j, j]
        vector /= np.sqrt((vector * vector).sum())
    return vector


@compiled()
def _normalising(points: Floats) -> Floats:
    """Matrix [3, 3] that brings points [m, 2] to mean distance √2 from 0."""
    x, y = points[:, 0].mean(), points[:, 1].mean()
    scale = np.sqrt(2) / max(np.sqrt((points[:, 0] - x) ** 2 + (points[:, 1] - y) ** 2).mean(), 1e-9)
    return np.array([[scale, 0.0, -scale * x], [0.0, scale, -scale * y], [0.0, 0.0, 1.0]])
