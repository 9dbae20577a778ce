"""Readable twins of the compiled code in comotion.pixels.kernels: same arguments, float64, plain NumPy."""

from itertools import pairwise

import numpy as np


def fit_affine(x, y, u, v, w, ridge):
    """One field: its weighted means, centred normal matrix with ridge, and (a, b, c, d, e, f)."""
    points, moves = np.stack([x, y], 1), np.stack([u, v], 1)
    centre, mean = np.average(points, 0, w), np.average(moves, 0, w)
    normal = (points - centre).T @ ((points - centre) * w[:, None]) + ridge * w.sum() * np.eye(2)
    matrix = np.linalg.solve(normal, (points - centre).T @ ((moves - mean) * w[:, None])).T
    return centre, normal, np.array([*matrix.ravel(), *(mean - matrix @ centre)])


def residual(field, x, y, u, v):
    a, b, c, d, e, f = field
    return (u - a * x - b * y - e) ** 2 + (v - c * x - d * y - f) ** 2


def fit_local_motions(start, displacement, seen, members, ridge):
    motions = np.zeros((len(seen), members.shape[1], 6))
    used = np.zeros(motions.shape[:2])
    for q, h in np.ndindex(used.shape):
        inside = members[seen[q, members[:, h]] > 0, h]
        if len(inside) >= 4:
            columns = *start[q][:, inside], *displacement[q][:, inside]
            motions[q, h] = fit_affine(*columns, np.ones(len(inside)), ridge)[2]
            used[q, h] = 1
    return motions, used


def total_residuals(start, displacement, seen, motions, caps):
    """Sums over frame pairs of the capped squared residuals [H, N]."""
    return sum(
        np.array([np.minimum(residual(m, *x, *d) * s, c) for m, c in zip(of, most, strict=True)])
        for x, d, s, of, most in zip(start, displacement, seen, motions, caps, strict=True)
    )


def normalising(points):
    """Matrix that brings points [m, 2] to mean distance √2 from 0."""
    centre = points.mean(0)
    scale = np.sqrt(2) / np.linalg.norm(points - centre, axis=1).mean()
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1]])


def epipolar_misfits(first, second, starts, picks):
    first, second = (np.column_stack([x, np.ones(len(x))]) for x in (first, second))
    misfits = np.zeros((len(picks), len(starts) - 1))
    for h, picked in enumerate(picks):
        left, right = normalising(first[picked, :2]), normalising(second[picked, :2])
        p, q = first[picked] @ left.T, second[picked] @ right.T
        rows = (q[:, :, None] * p[:, None]).reshape(-1, 9)
        u, s, v = np.linalg.svd(np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3))
        matrix = right.T @ (u * [s[0], s[1], 0]) @ v @ left
        lines, back = first @ matrix.T, second @ matrix
        gradient = (lines[:, :2] ** 2).sum(1) + (back[:, :2] ** 2).sum(1)
        square = (second * lines).sum(1) ** 2 / gradient
        misfits[h] = [square[a:b].mean() for a, b in pairwise(starts)]
    return misfits
