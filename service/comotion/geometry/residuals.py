"""Compiled: cost of each row under each body, from its residuals in the frame of the body."""

import numpy as np

from ..arrays import Floats, Slots
from ..compiled import compiled
from .procrustes import SOFT
from .records import RowArrays, quadratic

LEAST_COVERED = 0.6
"""Share of a row's frames in which a body must be posed to be charged the expected residual elsewhere."""
# Rows that are computed side by side. Their number is fixed, and what a loop writes is in one array, so that
# the compiler sees that the turns of the innermost loops are independent, and takes several at once.
_LANES = 16
# Parts of arrays with a value for each of those rows. Of their noise: 1 / tolerance and the weight of a
# squared distance in the robust mean, white and slow part and persistence, first number of the metric.
_INVERSE, _WEIGHT, _WHITE, _SLOW, _PERSISTENCE, _METRIC = (part * _LANES for part in range(6))
# Of what is summed over the frames: the mean place, or sums for it, weights, and frames with a pose; the
# expected place, or sums for the robust mean, and weights; capped squares, squares, log ratios of variances.
_MEAN, _TOTAL, _HELD, _STATE, _ROBUST, _PAID, _SQUARED, _RATIO = (
    part * _LANES for part in (0, 3, 4, 5, 8, 9, 10, 11)
)
# Frames after which products of ratios are replaced by their logarithms: far from overflow.
_PRODUCT = 32


@compiled()
def body_costs(
    arrays: RowArrays,
    rows: Slots,
    poses: Floats,
    deformation: tuple[Floats, float],
    unposed: float,
    dim: int,
    cap: float,
    cost: Floats,
    squared: Floats,
) -> None:
    """Cost of rows under each body, 1/2 sum_f (min(e_f^2 / s_f, cap dim) + dim log(s_f / s0_f)), in place.

    e_f is the innovation of the row in the body's frame, about its robust mean there: the distance from what
    a Kalman filter of slow noise and deformation expects. s_f is its variance, s0_f that without deformation.

    Parameters
    ----------
    rows
        intp [n], rows to take.
    poses
        float64 [K, F, 13], of :func:`~.body.stacked`.
    deformation
        Variance of the deformation of each body, float64 [K], and its correlation from frame to frame.
    unposed
        Twice the cost of a frame without a pose where a body covers little of a row. Where it covers most
        frames of the row, the others cost the expected residual.
    cost
        Out: float64 [n, K], in nats.
    squared
        Out: float64 [n, K], the mean of w e^2 over posed frames, in variances of the white noise.
    """
    count = arrays.w.shape[1]
    y, x = np.empty((count, 4 * _LANES)), np.empty((count, 4 * _LANES))
    rigid, gains = np.empty((count, 2 * _LANES)), np.empty((count, 2 * _LANES))
    noise, mixed = np.empty(11 * _LANES), np.empty(11 * _LANES)
    sums, seen = np.empty(12 * _LANES), np.empty(_LANES)
    for n in range(0, len(rows), _LANES):
        chosen = rows[n : n + _LANES]
        first, stop = _load(arrays, chosen, dim, y, noise, seen)
        observed = y[first:stop]
        _filter_gains(observed, noise, 0.0, 0.0, mixed, rigid)
        for k in range(len(poses)):
            path, soft = poses[k, first:stop], deformation[0][k]
            _filter_gains(observed, noise, soft, deformation[1], mixed, gains)
            _place(observed, path, x, sums)
            # The plain mean of few frames with a gross error is far from all of them: one step is too few.
            for _ in range(2):
                _robust_means(x, path, noise, sums)
            _innovations(x, path, gains, mixed, cap * dim, sums)
            if soft > 0:
                _log_ratios(x[: len(path)], rigid, gains, sums)
            for j in range(len(chosen)):
                held = sums[_HELD + j]
                missing = (dim if held >= LEAST_COVERED * seen[j] else unposed) * (seen[j] - held)
                cost[n + j, k] = 0.5 * (missing + sums[_PAID + j] + dim * sums[_RATIO + j])
                squared[n + j, k] = sums[_SQUARED + j] / max(held, 1.0)


@compiled()
def _load(
    arrays: RowArrays, rows: Slots, dim: int, lanes: Floats, noise: Floats, seen: Floats
) -> tuple[int, int]:
    """Copy at most :data:`_LANES` rows; their first frame with an observation, and one past the last.

    `lanes` [F, 4 lanes] gets coordinates and weights, `noise` the parts named above, `seen` [lanes] how many
    frames are observed. Lanes without a row are never observed.
    """
    y, w, tolerance, spectrum, metric = arrays
    lanes[:], noise[:], seen[:] = 0.0, 1.0, 0.0
    noise[_SLOW : _SLOW + 2 * _LANES] = 0.0
    first, stop = len(lanes), 0
    for j in range(len(rows)):
        i = rows[j]
        noise[_INVERSE + j], noise[_WEIGHT + j] = 1.0 / tolerance[i], 1.0 / tolerance[i] / (SOFT * dim)
        for c in range(3):
            noise[_WHITE + c * _LANES + j] = spectrum[i, c]
        for c in range(6):
            noise[_METRIC + c * _LANES + j] = metric[i, c]
        for f in range(len(lanes)):
            if w[i, f] > 0:
                first, stop = min(first, f), max(stop, f + 1)
                seen[j] += 1.0
                lanes[f, 3 * _LANES + j] = w[i, f]
                for c in range(3):
                    lanes[f, c * _LANES + j] = y[i, f, c]
    return min(first, stop), stop


@compiled()
def _filter_gains(
    lanes: Floats, noise: Floats, soft: float, persistence: float, mixed: Floats, gains: Floats
) -> None:
    """Gain of a Kalman filter of the slow noise, and inverse variance of its innovations, to [F, 2 lanes].

    The latter are in tolerances, and relative to the weight of the observation. The slow noise with that of a
    deformation of variance `soft` is `mixed`.
    """
    mixed[:] = noise
    if soft > 0:
        for j in range(_LANES):
            slow, added = noise[_SLOW + j], soft * noise[_INVERSE + j]
            lasting = slow * noise[_PERSISTENCE + j] + added * persistence
            mixed[_SLOW + j], mixed[_PERSISTENCE + j] = slow + added, lasting / (slow + added)
    variance = mixed[_SLOW : _SLOW + _LANES].copy()
    for f in range(len(lanes)):
        row, gain = lanes[f], gains[f]
        for j in range(_LANES):
            a = row[3 * _LANES + j]
            inverse = 1.0 / (variance[j] * a + mixed[_WHITE + j])
            gain[_LANES + j] = inverse
            gain[j] = variance[j] * a * inverse
        for j in range(_LANES):
            decay = mixed[_PERSISTENCE + j] * mixed[_PERSISTENCE + j]
            left = variance[j] - gain[j] * variance[j]
            variance[j] = decay * left + (1.0 - decay) * mixed[_SLOW + j]


@compiled()
def _place(lanes: Floats, poses: Floats, x: Floats, sums: Floats) -> None:
    """Points in the frame of a body, and weights, 0 where it has no pose, to x [F, 4 lanes]; their mean."""
    sums[:] = 0.0
    for f in range(len(lanes)):
        p, row, inside = poses[f], lanes[f], x[f]
        r0, r1, r2, r3, r4, r5, r6, r7, r8 = p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8]
        t0, t1, t2, posed = p[9], p[10], p[11], p[12]
        for j in range(_LANES):
            z0, z1, z2 = row[j] - t0, row[_LANES + j] - t1, row[2 * _LANES + j] - t2
            inside[j] = r0 * z0 + r3 * z1 + r6 * z2
            inside[_LANES + j] = r1 * z0 + r4 * z1 + r7 * z2
            inside[2 * _LANES + j] = r2 * z0 + r5 * z1 + r8 * z2
            inside[3 * _LANES + j] = row[3 * _LANES + j] * posed
        for j in range(_LANES):
            a = inside[3 * _LANES + j]
            sums[_MEAN + j] += a * inside[j]
            sums[_MEAN + _LANES + j] += a * inside[_LANES + j]
            sums[_MEAN + 2 * _LANES + j] += a * inside[2 * _LANES + j]
            sums[_TOTAL + j] += a
            sums[_HELD + j] += 1.0 if a > 0 else 0.0
    for j in range(3 * _LANES):
        sums[_MEAN + j] /= sums[_TOTAL + j % _LANES] + 1e-300


@compiled()
def _robust_means(x: Floats, poses: Floats, noise: Floats, sums: Floats) -> None:
    """Mean of points with less weight for those far from the last mean, in its place."""
    sums[_STATE : _ROBUST + _LANES] = 0.0
    for f in range(len(poses)):
        p, row = poses[f], x[f]
        for j in range(_LANES):
            a = row[3 * _LANES + j]
            d2 = a * _squared(row, j, p, noise, sums, _MEAN)
            g = a / (1.0 + noise[_WEIGHT + j] * d2)
            sums[_STATE + j] += g * row[j]
            sums[_STATE + _LANES + j] += g * row[_LANES + j]
            sums[_STATE + 2 * _LANES + j] += g * row[2 * _LANES + j]
            sums[_ROBUST + j] += g
    for j in range(3 * _LANES):
        sums[_MEAN + j] = sums[_STATE + j] / (sums[_ROBUST + j % _LANES] + 1e-300)
        sums[_STATE + j] = sums[_MEAN + j]


@compiled()
def _innovations(x: Floats, poses: Floats, gains: Floats, noise: Floats, most: float, sums: Floats) -> None:
    """Sums of squared distances from what a filter of the slow noise expects (Kalman 1960), capped and not.

    The filter begins at the mean. Innovations are independent from frame to frame, and have the variance of
    the tolerance.
    """
    for f in range(len(poses)):
        p, row, gain = poses[f], x[f], gains[f]
        for j in range(_LANES):
            a, lasting = row[3 * _LANES + j], noise[_PERSISTENCE + j]
            d2 = a * _squared(row, j, p, noise, sums, _STATE) * gain[_LANES + j]
            g = gain[j] / (1.0 + noise[_WEIGHT + j] * d2) if a > 0 else 0.0
            m0, s0 = sums[_MEAN + j], sums[_STATE + j]
            m1, s1 = sums[_MEAN + _LANES + j], sums[_STATE + _LANES + j]
            m2, s2 = sums[_MEAN + 2 * _LANES + j], sums[_STATE + 2 * _LANES + j]
            sums[_STATE + j] = m0 + lasting * (s0 + g * (row[j] - s0) - m0)
            sums[_STATE + _LANES + j] = m1 + lasting * (s1 + g * (row[_LANES + j] - s1) - m1)
            sums[_STATE + 2 * _LANES + j] = m2 + lasting * (s2 + g * (row[2 * _LANES + j] - s2) - m2)
            sums[_PAID + j] += min(d2 * noise[_INVERSE + j], most)
            sums[_SQUARED + j] += d2


@compiled()
def _squared(row: Floats, j: int, p: Floats, noise: Floats, sums: Floats, centre: int) -> float:
    """Squared distance of a row in the frame of a body with pose [13] from a place, under its metric."""
    a, b = row[j] - sums[centre + j], row[_LANES + j] - sums[centre + _LANES + j]
    c = row[2 * _LANES + j] - sums[centre + 2 * _LANES + j]
    u, v, z = p[0] * a + p[1] * b + p[2] * c, p[3] * a + p[4] * b + p[5] * c, p[6] * a + p[7] * b + p[8] * c
    across = noise[_METRIC + _LANES + j] * u * v + noise[_METRIC + 2 * _LANES + j] * u * z
    across += noise[_METRIC + 4 * _LANES + j] * v * z
    along = noise[_METRIC + j] * u * u + noise[_METRIC + 3 * _LANES + j] * v * v
    return float(along + noise[_METRIC + 5 * _LANES + j] * z * z + 2.0 * across)


@compiled()
def _log_ratios(x: Floats, gains: Floats, soft_gains: Floats, sums: Floats) -> None:
    """Log of the product of the variances of innovations, with deformation over without, in posed frames."""
    product = np.ones(_LANES)
    for f in range(len(x)):
        row, rigid, soft = x[f], gains[f], soft_gains[f]
        for j in range(_LANES):
            product[j] *= rigid[_LANES + j] / soft[_LANES + j] if row[3 * _LANES + j] > 0 else 1.0
        if (f + 1) % _PRODUCT == 0 or f + 1 == len(x):
            for j in range(_LANES):
                sums[_RATIO + j] += np.log(product[j])
                product[j] = 1.0


@compiled()
def recent_residuals(
    arrays: RowArrays,
    body: Slots,
    poses: Floats,
    soft: Floats,
    span: tuple[int, int, int],
    squared: Floats,
    count: Floats,
) -> None:
    """How far each row is at the newest frames from its mean before them, in the frame of its body, in place.

    Parameters
    ----------
    body
        intp [P], body of each row; below 0 for none.
    poses
        As of :func:`body_costs`.
    soft
        float64 [K], variance of the deformation of each body.
    span
        First frame of the mean, one past the last, from which on frames are judged, and one past those.
    squared, count
        Out: float64 [P] each, sum of the squared distances in tolerances, and number of frames.
    """
    y, w, tolerance, _, metric = arrays
    (first, split, stop), x = span, np.zeros(3)
    for i in range(len(body)):
        k = body[i]
        if k < 0:
            continue
        total, m0, m1, m2 = 0.0, 0.0, 0.0, 0.0
        for f in range(first, split):
            a = w[i, f] * poses[k, f, 12]
            if a > 0:
                _in_body(y[i, f], poses[k, f], x)
                total, m0, m1, m2 = total + a, m0 + a * x[0], m1 + a * x[1], m2 + a * x[2]
        if total == 0.0:
            continue
        variance = (tolerance[i] + soft[k]) * (1.0 + 1.0 / total)
        for f in range(split, stop):
            a, p = w[i, f] * poses[k, f, 12], poses[k, f]
            if a > 0:
                _in_body(y[i, f], p, x)
                u, v, z = x[0] - m0 / total, x[1] - m1 / total, x[2] - m2 / total
                e0, e1 = p[0] * u + p[1] * v + p[2] * z, p[3] * u + p[4] * v + p[5] * z
                d2 = quadratic(metric[i], e0, e1, p[6] * u + p[7] * v + p[8] * z)
                squared[i] += a * d2 / variance
                count[i] += 1.0


@compiled()
def _in_body(y: Floats, pose: Floats, x: Floats) -> None:
    """A point [3] in the frame of a body with a pose [13], to x [3]."""
    z0, z1, z2 = y[0] - pose[9], y[1] - pose[10], y[2] - pose[11]
    for c in range(3):
        x[c] = pose[c] * z0 + pose[3 + c] * z1 + pose[6 + c] * z2
