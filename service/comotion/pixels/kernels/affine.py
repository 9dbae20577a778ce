"""Fits affine displacement fields to displacements over frame pairs, and gives their residuals.

A field predicts the displacement (u, v) of a trajectory at (x, y): u = a x + b y + e, v = c x + d y + f.
"""

import numpy as np

from ...arrays import Floats, Floats32, Ints
from ...compiled import compiled

# A local motion has six parameters; three members would be fitted exactly, whatever bodies they are on.
_LEAST_MEMBERS = 4


@compiled()
def fit_local_motions(
    start: Floats32, displacement: Floats32, seen: Floats32, members: Ints, ridge: float
) -> tuple[Floats32, Floats32]:
    """Fields of local motions with members [M, H] in each frame pair, by least squares with a ridge.

    The ridge (px² per member) goes on the diagonal of the centred normal matrix. Returns the fields
    (a, b, c, d, e, f) [Q, H, 6] and whether enough members were seen, 1 or 0, [Q, H].
    """
    size, count = members.shape
    motions = np.zeros((len(seen), count, 6), np.float32)
    used = np.zeros((len(seen), count), np.float32)
    x, y, u, v, w = np.empty((5, size, count), np.float32)
    for q in range(len(seen)):
        # Gathered first: the sums of the fit then go over contiguous numbers.
        for m in range(size):
            for h in range(count):
                i = members[m, h]
                x[m, h], y[m, h], w[m, h] = start[q, 0, i], start[q, 1, i], seen[q, i]
                u[m, h], v[m, h] = displacement[q, 0, i], displacement[q, 1, i]
        means, moments = np.zeros((5, count)), np.zeros((7, count))
        _means(x, y, u, v, w, means)
        _moments(x, y, u, v, w, means, moments)
        for h in range(count):
            n, cx, cy, cu, cv = means[:, h]
            if n < _LEAST_MEMBERS:
                continue
            used[q, h] = 1
            xx, yy, xy, xu, yu, xv, yv = moments[:, h]
            xx += n * ridge
            yy += n * ridge
            det = xx * yy - xy * xy
            a, b = (xu * yy - yu * xy) / det, (yu * xx - xu * xy) / det
            c, d = (xv * yy - yv * xy) / det, (yv * xx - xv * xy) / det
            field = a, b, c, d, cu - a * cx - b * cy, cv - c * cx - d * cy
            for k in range(6):
                motions[q, h, k] = field[k]
    return motions, used


@compiled()
def _means(x: Floats32, y: Floats32, u: Floats32, v: Floats32, w: Floats32, means: Floats) -> None:
    n, cx, cy, cu, cv = means
    for m in range(len(x)):
        for h in range(len(n)):
            n[h] += w[m, h]
            cx[h] += w[m, h] * x[m, h]
            cy[h] += w[m, h] * y[m, h]
            cu[h] += w[m, h] * u[m, h]
            cv[h] += w[m, h] * v[m, h]
    for h in range(len(n)):
        if n[h] > 0:
            cx[h], cy[h], cu[h], cv[h] = cx[h] / n[h], cy[h] / n[h], cu[h] / n[h], cv[h] / n[h]


@compiled()
def _moments(
    x: Floats32, y: Floats32, u: Floats32, v: Floats32, w: Floats32, means: Floats, moments: Floats
) -> None:
    _, cx, cy, cu, cv = means
    xx, yy, xy, xu, yu, xv, yv = moments
    for m in range(len(x)):
        for h in range(len(cx)):
            px, py = x[m, h] - cx[h], y[m, h] - cy[h]
            wx, wy = px * w[m, h], py * w[m, h]
            pu, pv = u[m, h] - cu[h], v[m, h] - cv[h]
            xx[h] += wx * px
            yy[h] += wy * py
            xy[h] += wx * py
            xu[h] += wx * pu
            yu[h] += wy * pu
            xv[h] += wx * pv
            yv[h] += wy * pv


# Halves the time. The products that are fused into sums are all written here, so that it changes no bit from
# one process to another.
@compiled(fastmath={"contract"})
def total_residuals(
    start: Floats32, displacement: Floats32, seen: Floats32, motions: Floats32, caps: Floats32
) -> Floats32:
    """Sums of squared residuals of motions [Q, H, 6], each capped (0: the motion does not count), [H, N]."""
    pairs, count, _ = motions.shape
    total = np.zeros((count, start.shape[2]), np.float32)
    # Two motions at a time: fetching the trajectories takes the time. An odd last one goes twice.
    for first in range(0, count, 2):
        second = min(first + 1, count - 1)
        r, s = np.zeros((2, start.shape[2]), np.float32)
        for q in range(pairs):
            x, y, u, v, w = start[q, 0], start[q, 1], displacement[q, 0], displacement[q, 1], seen[q]
            a, b, c, d, e, f = motions[q, first]
            g, h, j, k, m, n = motions[q, second]
            most, limit = caps[q, first], caps[q, second]
            for i in range(len(x)):
                ru, rv = u[i] - a * x[i] - b * y[i] - e, v[i] - c * x[i] - d * y[i] - f
                su, sv = u[i] - g * x[i] - h * y[i] - m, v[i] - j * x[i] - k * y[i] - n
                r[i] += min((ru * ru + rv * rv) * w[i], most)
                s[i] += min((su * su + sv * sv) * w[i], limit)
        total[first], total[second] = r, s
    return total
