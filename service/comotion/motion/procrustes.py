"""Compiled: generalised Procrustes with missing data and robust weights, and residuals under a motion.

Points have three coordinates; in 2-D the third is zero and rotations are about z.
"""

import numpy as np

from ..pixels.compiled import compiled
from ..window import Bools, Floats
from .rotation import planar_rotation, spatial_rotation

# A squared residual of this many tolerances per dimension halves an observation's weight.
_SOFT = 9.0
# Pull towards the neighbouring frame's rotation, as a share of the moments: it settles what the points
# leave open, such as a pair's turning about itself.
_PULL = 1e-3


@compiled()
def fit_body(
    y: Floats,
    w: Floats,
    inverse: Floats,
    dim: int,
    iterations: int,
    b: Floats,
    R: Floats,
    t: Floats,
    posed: Bools,
) -> None:
    """Fit poses x = R b + t to rows, in place.

    Grown from the fullest frame, newest first: poses from what is known of the template, the template
    from the poses, with weights 1 / (1 + r^2 / (9 dim v)).

    Parameters
    ----------
    y, w, inverse
        float64 [m, F, 3], [m, F] (0: unobserved) and [m], inverse tolerance.
    b, R, t, posed
        Out: float64 [m, 3], [F, 3, 3], [F, 3], bool [F].
    """
    known = np.zeros(len(w), np.bool_)
    _seed(y, w, b, known)
    need = 2 if (dim == 2 or len(w) <= 2) else 3
    weights = np.zeros(len(w))
    for iteration in range(iterations):
        sums = np.zeros((len(w), 4))
        neighbour = -1
        for f in range(w.shape[1] - 1, -1, -1):
            robust = iteration > 0 and posed[f]
            count = _weigh(y, w, inverse, dim, b, known, R[f], t[f], f, robust, weights)
            posed[f] = count >= need
            if posed[f]:
                _pose(y, b, weights, f, dim, neighbour, R, t)
                neighbour = f
                _collect(y, w, inverse, dim, b, known, R[f], t[f], f, sums)
        _update(sums, b, known)


@compiled()
def _seed(y: Floats, w: Floats, b: Floats, known: Bools) -> None:
    """Template of the rows seen in the fullest frame, the newest of equals."""
    best, most = 0, 0
    for f in range(w.shape[1] - 1, -1, -1):
        count = 0
        for i in range(len(w)):
            count += w[i, f] > 0
        if count > most:
            best, most = f, count
    for i in range(len(w)):
        if w[i, best] > 0:
            known[i] = True
            b[i] = y[i, best]


@compiled()
def _weigh(
    y: Floats,
    w: Floats,
    inverse: Floats,
    dim: int,
    b: Floats,
    known: Bools,
    R: Floats,
    t: Floats,
    f: int,
    robust: bool,
    weights: Floats,
) -> int:
    """Weights [m] of a frame's points in its pose; how many there are."""
    count = 0
    for i in range(len(w)):
        weights[i] = 0.0
        if not known[i] or w[i, f] <= 0:
            continue
        count += 1
        weights[i] = w[i, f] * inverse[i]
        if robust:
            squared = 0.0
            for c in range(3):
                r = y[i, f, c] - t[c] - R[c, 0] * b[i, 0] - R[c, 1] * b[i, 1] - R[c, 2] * b[i, 2]
                squared += r * r
            weights[i] /= 1.0 + squared * weights[i] / (_SOFT * dim)
    return count


@compiled()
def _pose(
    y: Floats, b: Floats, weights: Floats, f: int, dim: int, neighbour: int, R: Floats, t: Floats
) -> None:
    """Weighted least-squares pose of frame f."""
    total, cy, cb = 0.0, np.zeros(3), np.zeros(3)
    for i in range(len(weights)):
        total += weights[i]
        for c in range(3):
            cy[c] += weights[i] * y[i, f, c]
            cb[c] += weights[i] * b[i, c]
    cy /= total
    cb /= total
    H = np.zeros((3, 3))
    for i in range(len(weights)):
        if weights[i] > 0:
            for p in range(3):
                for q in range(3):
                    H[p, q] += weights[i] * (y[i, f, p] - cy[p]) * (b[i, q] - cb[q])
    if dim == 2:
        planar_rotation(H, R[f])
    else:
        pull = _PULL * np.sqrt((H * H).sum())
        H += pull * (R[neighbour] if neighbour >= 0 else np.eye(3))
        spatial_rotation(H, R[f])
    for c in range(3):
        t[f, c] = cy[c] - R[f, c, 0] * cb[0] - R[f, c, 1] * cb[1] - R[f, c, 2] * cb[2]


@compiled()
def _collect(
    y: Floats,
    w: Floats,
    inverse: Floats,
    dim: int,
    b: Floats,
    known: Bools,
    R: Floats,
    t: Floats,
    f: int,
    sums: Floats,
) -> None:
    """Add a frame's points, in the body's frame, to the weighted sums [m, 4] of the template."""
    x = np.zeros(3)
    for i in range(len(w)):
        a = w[i, f] * inverse[i]
        if a <= 0:
            continue
        _to_body(R, t, y[i, f], x)
        if known[i]:
            r2 = (x[0] - b[i, 0]) ** 2 + (x[1] - b[i, 1]) ** 2 + (x[2] - b[i, 2]) ** 2
            a /= 1.0 + r2 * a / (_SOFT * dim)
        sums[i, 3] += a
        for c in range(3):
            sums[i, c] += a * x[c]


@compiled()
def _to_body(R: Floats, t: Floats, y: Floats, x: Floats) -> None:
    """Body coordinates x = R^T (y - t)."""
    z0, z1, z2 = y[0] - t[0], y[1] - t[1], y[2] - t[2]
    for c in range(3):
        x[c] = R[0, c] * z0 + R[1, c] * z1 + R[2, c] * z2


@compiled()
def _update(sums: Floats, b: Floats, known: Bools) -> None:
    for i in range(len(sums)):
        if sums[i, 3] > 0:
            known[i] = True
            for c in range(3):
                b[i, c] = sums[i, c] / sums[i, 3]


@compiled()
def body_cost(
    y: Floats,
    w: Floats,
    inverse: Floats,
    dim: int,
    cap: float,
    R: Floats,
    t: Floats,
    posed: Bools,
    unposed: float,
    cost: Floats,
    squared: Floats,
) -> None:
    """Cost of each row under one motion, 1/2 sum_f min(w |x - b|^2 / v, cap dim), in place.

    x is the row in the body's frame, b its robust mean there; a frame without pose costs
    `unposed` / 2. `squared` [P] is the mean of w |x - b|^2 over posed frames.
    """
    x = np.zeros((w.shape[1], 3))
    for i in range(len(w)):
        count, missing = 0, 0
        for f in range(w.shape[1]):
            if w[i, f] > 0:
                count += posed[f]
                missing += not posed[f]
                _to_body(R[f], t[f], y[i, f], x[f])
        cost[i], squared[i] = 0.5 * unposed * missing, 0.0
        if count:
            b = _mean(x, w[i], posed, np.zeros(3), 0.0)
            b = _mean(x, w[i], posed, b, inverse[i] / (_SOFT * dim))
            for f in range(w.shape[1]):
                if w[i, f] > 0 and posed[f]:
                    r2 = w[i, f] * _distance2(x[f], b)
                    squared[i] += r2 / count
                    cost[i] += 0.5 * min(r2 * inverse[i], cap * dim)


@compiled()
def _mean(x: Floats, w: Floats, posed: Bools, about: Floats, soft: float) -> Floats:
    """Mean of x [F, 3] with weights w / (1 + soft w |x - about|^2), [3]."""
    total, mean = 0.0, np.zeros(3)
    for f in range(len(w)):
        if w[f] > 0 and posed[f]:
            a = w[f] / (1.0 + soft * w[f] * _distance2(x[f], about))
            total += a
            for c in range(3):
                mean[c] += a * x[f, c]
    return mean / total


@compiled()
def _distance2(a: Floats, b: Floats) -> float:
    return float((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)
