"""Points in two frames in; residuals of the affine motion that fits them best out."""

import numpy as np

from ...arrays import Floats
from ...compiled import compiled
from .affine import fit_affine

# Rounds of reweighting in the robust fit.
_AFFINE_ROUNDS = 4
# px² per unit of weight; points on a line still have a solution.
_RIDGE = 1e-3
# px²; smallest typical squared residual that weights refer to.
_LEAST_TYPICAL = 1e-4


@compiled()
def affine_residual_alone(x: Floats, y: Floats) -> float:
    """Median squared residual of points [n, 2] that are fitted alone, px²."""
    median: float = np.median(_robust_residuals(x, y, np.ones(len(x))))
    return median


@compiled()
def affine_residuals_joint(xa: Floats, ya: Floats, xb: Floats, yb: Floats) -> tuple[float, float]:
    """Median squared residual of each of two groups when both are fitted together, px²."""
    count = len(xa)
    prior = np.empty(count + len(xb))
    # A large group must not outvote a small one.
    prior[:count] = count**-0.5
    prior[count:] = len(xb) ** -0.5
    square = _robust_residuals(np.concatenate((xa, xb)), np.concatenate((ya, yb)), prior)
    return np.median(square[:count]), np.median(square[count:])


@compiled()
def _robust_residuals(x: Floats, y: Floats, prior: Floats) -> Floats:
    """Squared residuals [n] under a reweighted affine fit; `prior` [n] weighs points."""
    move = y - x
    # One field; the kernel takes a column each.
    px, py, u, v = (
        np.ascontiguousarray(x[:, 0:1]),
        np.ascontiguousarray(x[:, 1:2]),
        np.ascontiguousarray(move[:, 0:1]),
        np.ascontiguousarray(move[:, 1:2]),
    )
    weight = prior.copy()
    square = np.zeros(len(x))
    for _ in range(_AFFINE_ROUNDS):
        _, _, fields = fit_affine(px, py, u, v, weight.reshape(-1, 1), _RIDGE)
        a, b, c, d, e, f = fields[:, 0]
        square = (u[:, 0] - a * px[:, 0] - b * py[:, 0] - e) ** 2
        square += (v[:, 0] - c * px[:, 0] - d * py[:, 0] - f) ** 2
        weight = prior / np.sqrt(1 + square / (4 * max(np.median(square), _LEAST_TYPICAL)))
    return square
