"""Readable twins of the compiled code in comotion.pixels.kernels: same arguments, float64, plain NumPy."""

from itertools import pairwise

import numpy as np


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
