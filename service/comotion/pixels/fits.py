"""Fits epipolar geometry and affine motion robustly to points in pairs of frames, and gives the residuals.

All pairs of frames are fitted at once.
"""

from collections.abc import Callable

import numpy as np

from ..arrays import Bools, Floats
from .medians import median

Model = Callable[[Floats, Floats, Bools], Callable[[Floats], Floats]]
"""Points [P, n, 2] in both frames of P pairs, and which are seen -> weights [P, n] -> squared residuals."""

# Rounds of reweighting in robust fits, and px²; smallest typical squared residual that weights refer to.
_ROUNDS, _LEAST_TYPICAL = 3, 0.01
# px² per unit of weight; points on a line still have an affine motion.
_RIDGE_PX2 = 1e-3


def residuals(model: Model, x: Floats, y: Floats, prior: Floats) -> Floats:
    """Squared residuals [P, n] under reweighted fits; `prior` [P, n] weighs points, 0 for none: NaN."""
    seen = prior > 0
    fit, weight = model(x, y, seen), prior
    square = fit(weight)
    for _ in range(_ROUNDS - 1):
        typical = np.fmax(median(np.where(seen, square, np.nan), 1), _LEAST_TYPICAL)[:, None]
        square = fit(prior / np.sqrt(1 + square / (4 * typical)))
    return np.where(seen, square, np.nan)


def fundamental(x: Floats, y: Floats, seen: Bools) -> Callable[[Floats], Floats]:
    """Squared Sampson distances under the normalised eight-point method (Hartley 1997)."""
    (p, u, left), (q, v, right) = _normalised(x, seen), _normalised(y, seen)
    rows = (v[..., :, None] * u[..., None, :]).reshape(*seen.shape, 9)

    def squares(weight: Floats) -> Floats:
        scaled = rows * weight[..., None]
        vector = np.linalg.eigh(scaled.mT @ scaled)[1][..., 0]
        a, s, b = np.linalg.svd(vector.reshape(-1, 3, 3))
        s[:, 2] = 0
        matrix = right.mT @ (a * s[:, None] @ b) @ left
        lines_in_second, lines_in_first = p @ matrix.mT, q @ matrix
        gradient = (lines_in_second[..., :2] ** 2).sum(axis=2) + (lines_in_first[..., :2] ** 2).sum(axis=2)
        return np.asarray((q * lines_in_second).sum(axis=2) ** 2 / np.maximum(gradient, 1e-12))

    return squares


def affine(x: Floats, y: Floats, seen: Bools) -> Callable[[Floats], Floats]:
    """Squared distances from an affine motion."""
    _, rows, normalising = _normalised(x, seen)
    move = y - x
    # The ridge holds the linear part, per px of place; `rows` are scaled.
    ridge = _RIDGE_PX2 * normalising[:, 0, 0, None, None] ** 2 * np.diag([1.0, 1.0, 0.0])

    def squares(weight: Floats) -> Floats:
        weighted = (rows * weight[..., None]).mT
        normal = weighted @ rows + weight.sum(axis=1)[:, None, None] * ridge + 1e-9 * np.eye(3)
        field = np.linalg.solve(normal, weighted @ move)
        return np.asarray(((move - rows @ field) ** 2).sum(axis=2))

    return squares


def _normalised(x: Floats, seen: Bools) -> tuple[Floats, Floats, Floats]:
    """Homogeneous points [P, n, 3], the same at mean distance √2 from 0, and the matrix for it [P, 3, 3]."""
    count = np.maximum(seen.sum(axis=1), 1)[:, None]
    centre = (x * seen[..., None]).sum(axis=1) / count
    distance = np.linalg.norm(x - centre[:, None], axis=2) * seen
    scale = np.sqrt(2) / np.maximum(distance.sum(axis=1) / count[:, 0], 1e-9)
    matrix = np.zeros((len(x), 3, 3))
    matrix[:, 0, 0] = matrix[:, 1, 1] = scale
    matrix[:, :2, 2] = -scale[:, None] * centre
    matrix[:, 2, 2] = 1
    points = np.concatenate([x, np.ones((*seen.shape, 1))], axis=2)
    return points, points @ matrix.mT, matrix
