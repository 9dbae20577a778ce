"""Points in two frames in; residuals of the fundamental matrix that fits them best out."""

import numpy as np

from ...arrays import Floats
from ...compiled import compiled

# Rounds of reweighting in the robust fit.
_ROUNDS = 3


@compiled()
def residual_alone(x: Floats, y: Floats) -> tuple[float, float]:
    """Median squared residual of points [n, 2] that are fitted alone, px², and their median motion, px."""
    displacement = y - x
    moved = np.sqrt(displacement[:, 0] ** 2 + displacement[:, 1] ** 2)
    return np.median(_robust_residuals(x, y, np.ones(len(x)))), np.median(moved)


@compiled()
def residuals_joint(xa: Floats, ya: Floats, xb: Floats, yb: Floats) -> tuple[float, float]:
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
    """Squared Sampson distances [n] under a reweighted eight-point fit; `prior` [n] weighs points."""
    rows, left, right = _equations(x, y)
    weight = prior.copy()
    square = np.zeros(len(x))
    for _ in range(_ROUNDS):
        scaled = rows * weight.reshape(-1, 1)
        vector = np.linalg.eigh(scaled.T @ scaled)[1][:, 0]
        u, s, vt = np.linalg.svd(np.ascontiguousarray(vector).reshape(3, 3))
        s[2] = 0
        square = _sampson(right.T @ ((u * s) @ vt) @ left, x, y)
        weight = prior / np.sqrt(1 + square / (4 * max(np.median(square), 0.01)))
    return square


@compiled()
def _equations(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Equations [n, 9] of the eight-point method and the normalising [3, 3] of both sides (Hartley 1997)."""
    sx, ax, bx = _normalisation(x)
    sy, ay, by = _normalisation(y)
    u, v = sx * x[:, 0] + ax, sx * x[:, 1] + bx
    p, q = sy * y[:, 0] + ay, sy * y[:, 1] + by
    rows = np.ones((len(x), 9))
    for k, column in enumerate((p * u, p * v, p, q * u, q * v, q, u, v)):
        rows[:, k] = column
    left = np.array([[sx, 0.0, ax], [0.0, sx, bx], [0.0, 0.0, 1.0]])
    right = np.array([[sy, 0.0, ay], [0.0, sy, by], [0.0, 0.0, 1.0]])
    return rows, left, right


@compiled()
def _normalisation(x: Floats) -> tuple[float, float, float]:
    """Scale and shift that bring points [n, 2] to the origin at mean distance √2."""
    cx, cy = x[:, 0].mean(), x[:, 1].mean()
    reach = np.sqrt((x[:, 0] - cx) ** 2 + (x[:, 1] - cy) ** 2).mean()
    scale = np.sqrt(2.0) / max(reach, 1e-9)
    return scale, -scale * cx, -scale * cy


@compiled()
def _sampson(f: Floats, x: Floats, y: Floats) -> Floats:
    """Squared Sampson distances [n], px², of points [n, 2] under a fundamental matrix [3, 3]."""
    ax = f[0, 0] * x[:, 0] + f[0, 1] * x[:, 1] + f[0, 2]
    ay = f[1, 0] * x[:, 0] + f[1, 1] * x[:, 1] + f[1, 2]
    az = f[2, 0] * x[:, 0] + f[2, 1] * x[:, 1] + f[2, 2]
    bx = f[0, 0] * y[:, 0] + f[1, 0] * y[:, 1] + f[2, 0]
    by = f[0, 1] * y[:, 0] + f[1, 1] * y[:, 1] + f[2, 1]
    error = y[:, 0] * ax + y[:, 1] * ay + az
    square: Floats = error**2 / np.maximum(ax**2 + ay**2 + bx**2 + by**2, 1e-12)
    return square
