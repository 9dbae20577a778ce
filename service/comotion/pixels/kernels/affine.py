"""Displacements over frame pairs in; affine displacement fields fitted to them, and their residuals, out.

A field predicts the displacement (u, v) of a trajectory at (x, y): u = a x + b y + e, v = c x + d y + f.
"""

import numpy as np

from ...arrays import Bools, Floats, Floats32, Ints
from ...compiled import compiled

Reals = Floats | Floats32

# A local motion has six parameters; three members would be fitted exactly, whatever bodies they are on.
_LEAST_MEMBERS = 4
# Fewer members of a group do not tell how far members deviate.
_LEAST_GROUP_MEMBERS = 8
# Rounds of reweighting in the robust fit of a group's motion.
_ROUNDS = 3
# px; smallest standard deviation that the members of a group are credited with.
_NOISE_PX = 0.3
# Median of the sum of two squared standard normal deviates, 2 ln 2.
_CHI2_MEDIAN_2D = 1.386
# The activity of a frame pair is a mean over every eighth local motion: they differ little in it, and
# one trajectory of one development sequence changed its group.
_ACTIVITY_STEP = 8


@compiled()
def pair_displacements(
    positions: Floats32, visible: Bools, first: Ints, second: Ints
) -> tuple[Floats32, Floats32, Floats32]:
    """Start and displacement [Q, 2, N] over frame pairs, 0 unless seen in both, and whether seen [Q, N]."""
    shape = len(first), 2, visible.shape[1]
    start, displacement = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    seen = np.zeros((len(first), visible.shape[1]), np.float32)
    for q in range(len(first)):
        a, b = first[q], second[q]
        for i in range(visible.shape[1]):
            if visible[a, i] and visible[b, i]:
                seen[q, i] = 1
                for c in range(2):
                    start[q, c, i] = positions[a, i, c]
                    displacement[q, c, i] = positions[b, i, c] - positions[a, i, c]
    return start, displacement, seen


@compiled()
def fit_affine(
    x: Reals, y: Reals, u: Reals, v: Reals, w: Reals, ridge: float
) -> tuple[Floats, Floats, Floats]:
    """Weighted least squares with a ridge for H fields at a time, each of M points; all inputs [M, H].

    The ridge (px² per unit of weight) goes on the diagonal of the centred normal matrix. Returns the sum
    of weights and the means of x, y, u, v [5, H], the centred normal matrix xx, yy, xy [3, H], and the
    fields (a, b, c, d, e, f) [6, H]. Without any weight a field is 0.
    """
    count = x.shape[1]
    means, moments, fields = np.zeros((5, count)), np.zeros((7, count)), np.zeros((6, count))
    _means(x, y, u, v, w, means)
    _moments(x, y, u, v, w, means, moments)
    for h in range(count):
        n, cx, cy, cu, cv = means[:, h]
        if n > 0:
            moments[0, h] += n * ridge
            moments[1, h] += n * ridge
            xx, yy, xy, xu, yu, xv, yv = moments[:, h]
            det = xx * yy - xy * xy
            a, b = (xu * yy - yu * xy) / det, (yu * xx - xu * xy) / det
            c, d = (xv * yy - yv * xy) / det, (yv * xx - xv * xy) / det
            fields[0, h], fields[1, h], fields[4, h] = a, b, cu - a * cx - b * cy
            fields[2, h], fields[3, h], fields[5, h] = c, d, cv - c * cx - d * cy
    return means, moments[:3], fields


@compiled()
def _means(x: Reals, y: Reals, u: Reals, v: Reals, w: Reals, means: Floats) -> None:
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
def _moments(x: Reals, y: Reals, u: Reals, v: Reals, w: Reals, means: Floats, moments: Floats) -> None:
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


@compiled()
def fit_local_motions(
    start: Floats32, displacement: Floats32, seen: Floats32, members: Ints, ridge: float
) -> tuple[Floats32, Floats32]:
    """Fields of local motions with members [M, H] in each frame pair.

    Returns the fields (a, b, c, d, e, f) [Q, H, 6] and whether enough members were seen, 1 or 0, [Q, H].
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
        means, _, fields = fit_affine(x, y, u, v, w, ridge)
        for h in range(count):
            if means[0, h] >= _LEAST_MEMBERS:
                used[q, h] = 1
                for k in range(6):
                    motions[q, h, k] = fields[k, h]
    return motions, used


# Halves the time. The products that are fused into sums are all written here, so that it changes no bit from
# one process to another.
@compiled(fastmath={"contract"})
def total_residuals(
    start: Floats32, displacement: Floats32, seen: Floats32, motions: Floats32, caps: Floats32
) -> Floats32:
    """Sums of squared residuals of motions [Q, H, 6], each capped (0: the motion does not count), [H, N]."""
    pairs, count, _ = motions.shape
    total = np.zeros((count, start.shape[2]), np.float32)
    # Two at a time: what takes the time is to fetch the trajectories. An odd last one goes twice.
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


@compiled()
def pair_activity(
    start: Floats32, displacement: Floats32, seen: Floats32, motions: Floats32, caps: Floats32
) -> Floats:
    """Mean of r² / (r² + 1 px²) over every eighth motion and the trajectories seen, [Q]."""
    activity = np.zeros(len(seen))
    for q in range(len(seen)):
        x, y, u, v, w = start[q, 0], start[q, 1], displacement[q, 0], displacement[q, 1], seen[q]
        active = np.zeros(len(x), np.float32)
        fitted = 0
        for h in range(0, motions.shape[1], _ACTIVITY_STEP):
            fitted += caps[q, h] > 0
            a, b, c, d, e, f = motions[q, h]
            for i in range(len(x)):
                ru, rv = u[i] - a * x[i] - b * y[i] - e, v[i] - c * x[i] - d * y[i] - f
                square = min((ru * ru + rv * rv) * w[i], caps[q, h])
                active[i] += square / (square + np.float32(1))
        total = 0.0
        for i in range(len(x)):
            total += active[i]
        activity[q] = total / max(fitted * w.sum(), 1)
    return activity


@compiled()
def group_deviations(
    start: Floats32, displacement: Floats32, seen: Floats32, labels: Ints, groups: int, ridge: float
) -> tuple[Floats, Floats]:
    """Squared deviations from the own group's motion [Q, N] and from every group's [K, Q, N], in variances.

    Infinite where a pair does not show the trajectory, or too few of the group. Away from the members
    a prediction is uncertain. The own deviation is divided by that, the others are not.
    """
    pairs, _, count = start.shape
    own = np.full((pairs, count), np.inf)
    every = np.full((groups, pairs, count), np.inf)
    for g in range(groups):
        members = np.flatnonzero(labels == g)
        means, moments, fields, variance = _robust_fit(start, displacement, seen, members, ridge)
        for q in range(pairs):
            if variance[q] > 0:
                x, y = start[q]
                u, v = displacement[q]
                deviation = _square(fields[:, q], x, y, u, v) / variance[q]
                leverage = _leverage(means[:, q], moments[:, q], x, y)
                every[g, q] = np.where(seen[q] > 0, deviation, np.inf)
                own[q] = np.where((seen[q] > 0) & (labels == g), deviation / (1 + leverage), own[q])
    return own, every


@compiled()
def _robust_fit(
    start: Floats32, displacement: Floats32, seen: Floats32, members: Ints, ridge: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Reweighted fit of a group's members in each frame pair, and the variance per axis in px², [Q].

    The variance is 0 where too few members are seen.
    """
    pairs, size = len(seen), len(members)
    x, y, u, v, w = np.empty((5, size, pairs))
    for m in range(size):
        for q in range(pairs):
            i = members[m]
            x[m, q], y[m, q], w[m, q] = start[q, 0, i], start[q, 1, i], seen[q, i]
            u[m, q], v[m, q] = displacement[q, 0, i], displacement[q, 1, i]
    variance = np.zeros(pairs)
    for _ in range(_ROUNDS):
        means, moments, fields = fit_affine(x, y, u, v, w, ridge)
        for q in range(pairs):
            if np.count_nonzero(w[:, q]) >= _LEAST_GROUP_MEMBERS:
                square = _square(fields[:, q], x[:, q], y[:, q], u[:, q], v[:, q])
                typical = np.median(square[w[:, q] > 0])
                variance[q] = max(typical / _CHI2_MEDIAN_2D, _NOISE_PX**2)
                w[:, q] = np.where(w[:, q] > 0, 1 / (1 + square / (4 * variance[q])), 0.0)
    return means, moments, fields, variance


@compiled()
def _square(field: Floats, x: Reals, y: Reals, u: Reals, v: Reals) -> Floats:
    """Squared residuals [n], px²."""
    ru = u - field[0] * x - field[1] * y - field[4]
    rv = v - field[2] * x - field[3] * y - field[5]
    square: Floats = ru * ru + rv * rv
    return square


@compiled()
def _leverage(means: Floats, moments: Floats, x: Reals, y: Reals) -> Floats:
    """How uncertain predictions are, [n], in units of the variance."""
    n, cx, cy = means[0], means[1], means[2]
    xx, yy, xy = moments
    dx, dy = x - cx, y - cy
    leverage: Floats = 1 / n + (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
    return leverage
