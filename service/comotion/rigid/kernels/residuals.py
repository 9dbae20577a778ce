"""Compiled: in rows and the poses of bodies, out the cost of each row under each body."""

import numpy as np

from ...arrays import Floats, Slots
from ...compiled import compiled
from .procrustes import SOFT
from .records import PoseStack, RowArrays

LEAST_COVERED = 0.6
"""Share of a row's frames in which a body must be posed to be charged the expected residual elsewhere."""
# A cost is first estimated on every stride-th frame if a row has at least so many of those. It is then
# computed on all frames for bodies whose estimate is below so many times the least plus so many nats.
# All three were chosen on the scenes of docs/research/accuracy.md.
_LEAST_ESTIMATE_FRAMES = 6
_NEAR_FACTOR, _NEAR_NATS = 3.0, 100.0


@compiled()
def body_costs(
    arrays: RowArrays,
    rows: Slots,
    poses: PoseStack,
    wider: Floats,
    unposed: float,
    dim: int,
    cap: float,
    stride: int,
    cost: Floats,
    squared: Floats,
) -> None:
    """Cost of rows under each body, 1/2 sum_f min(w |x - b|^2 / v, cap dim), in place.

    x is the row in the body's frame, b its robust mean there.

    Parameters
    ----------
    rows
        intp [n], rows to take.
    wider
        float64 [K], by how much the tolerance of a body exceeds that of a row: v = tolerance + wider.
    unposed
        Twice the cost of a frame without a pose where a body covers little of a row. Where it covers most
        frames of the row, the others cost the expected residual.
    stride
        Above 1: estimate on every stride-th frame first, and take all frames only for the bodies whose
        estimate is near the least. The others keep their estimate.
    cost, squared
        Out: float64 [n, K] each, the cost in nats, and the mean of w |x - b|^2 over posed frames.
    """
    y, w, tolerance, spectrum = arrays
    R, t, posed = poses
    count, bodies = w.shape[1], len(R)
    row, x, gains = np.empty((4, count)), np.empty((5, count)), np.empty((2, count))
    first_R, first_t = np.ascontiguousarray(R[:, :, ::stride]), np.ascontiguousarray(t[:, :, ::stride])
    first_posed = np.ascontiguousarray(posed[:, ::stride])
    for n in range(len(rows)):
        i = rows[n]
        first, stop = _observed_span(w[i])
        reach = np.inf
        if stride > 1 and stop - first >= _LEAST_ESTIMATE_FRAMES * stride:
            seen = _copy_row(y[i], w[i], stride, row)
            _filter_gains(row[3], spectrum[i], stride, gains)
            for k in range(bodies):
                cost[n, k], squared[n, k] = _body_cost(
                    row,
                    first_R[k],
                    first_t[k],
                    first_posed[k],
                    0,
                    first_posed.shape[1],
                    1.0 / (tolerance[i] + wider[k]),
                    dim,
                    cap,
                    unposed,
                    x,
                    gains,
                    spectrum[i, 2] ** stride,
                )
            cost[n] *= _copy_row(y[i], w[i], 1, row) / max(seen, 1)
            reach = _NEAR_FACTOR * cost[n].min() + _NEAR_NATS if seen > 0 else np.inf
        else:
            _copy_row(y[i], w[i], 1, row)
        _filter_gains(row[3], spectrum[i], 1, gains)
        for k in range(bodies):
            if reach == np.inf or cost[n, k] < reach:
                v = tolerance[i] + wider[k]
                cost[n, k], squared[n, k] = _body_cost(
                    row,
                    R[k],
                    t[k],
                    posed[k],
                    first,
                    stop,
                    1.0 / v,
                    dim,
                    cap,
                    unposed,
                    x,
                    gains,
                    spectrum[i, 2],
                )


@compiled()
def own_residuals(
    arrays: RowArrays,
    rows: Slots,
    first: Slots,
    poses: PoseStack,
    dim: int,
    most: float,
    excess: Floats,
) -> None:
    """How well each body fits the rows that it was fitted to, in place.

    Parameters
    ----------
    rows, first
        intp [n] and [K + 1]; rows[first[k]:first[k + 1]] are those of body k.
    excess
        Out: float64 [K], mean squared residual in tolerances and dimensions, that of each row at most `most`.
    """
    y, w, tolerance, spectrum = arrays
    R, t, posed = poses
    count = w.shape[1]
    row, x, gains = np.empty((4, count)), np.empty((5, count)), np.empty((2, count))
    for k in range(len(R)):
        for n in range(first[k], first[k + 1]):
            i = rows[n]
            _copy_row(y[i], w[i], 1, row)
            inverse = 1.0 / tolerance[i]
            _filter_gains(row[3], spectrum[i], 1, gains)
            _, squared = _body_cost(
                row, R[k], t[k], posed[k], 0, count, inverse, dim, 1.0, 0.0, x, gains, spectrum[i, 2]
            )
            excess[k] += min(squared * inverse / dim, most) / (first[k + 1] - first[k])


@compiled()
def _observed_span(w: Floats) -> tuple[int, int]:
    """First frame in which a row is observed, and one past the last."""
    first, stop = 0, len(w)
    while first < stop and w[first] <= 0:
        first += 1
    while stop > first and w[stop - 1] <= 0:
        stop -= 1
    return first, stop


@compiled()
def rest_costs(arrays: RowArrays, rows: Slots, wider: Floats, dim: int, cap: float, cost: Floats) -> None:
    """Cost of rows under the static body at wider tolerances, in place; as :func:`body_costs`.

    Parameters
    ----------
    rows
        intp [n], rows to take.
    wider
        float64 [K], by how much each tolerance exceeds that of a row.
    cost
        Out: float64 [n, K], nat.
    """
    y, w, tolerance, spectrum = arrays
    count = w.shape[1]
    row, squared, gains = np.empty((4, count)), np.empty(count), np.empty((2, count))
    for n in range(len(rows)):
        i = rows[n]
        _copy_row(y[i], w[i], 1, row)
        _filter_gains(row[3], spectrum[i], 1, gains)
        soft = 1.0 / (SOFT * dim * tolerance[i])
        mean = _robust_mean(row, 0, count, soft)
        _squares(row, 0, count, mean, gains, spectrum[i, 2], soft, squared)
        for k in range(len(wider)):
            inverse, paid = 1.0 / (tolerance[i] + wider[k]), 0.0
            for f in range(count):
                paid += min(squared[f] * inverse, cap * dim)
            cost[n, k] = 0.5 * paid


@compiled()
def _copy_row(y: Floats, w: Floats, stride: int, row: Floats) -> int:
    """Copy every stride-th frame of a row to [4, F]; return in how many of them it is observed."""
    seen = 0
    for f in range(0, len(w), stride):
        k = f // stride
        row[0, k], row[1, k], row[2, k], row[3, k] = y[f, 0], y[f, 1], y[f, 2], w[f]
        seen += w[f] > 0
    return seen


@compiled()
def _body_cost(
    row: Floats,
    R: Floats,
    t: Floats,
    posed: Floats,
    first: int,
    stop: int,
    inverse: float,
    dim: int,
    cap: float,
    unposed: float,
    x: Floats,
    gains: Floats,
    persistence: float,
) -> tuple[float, float]:
    """Cost of one row under one body at frames [first:stop], and its mean squared residual.

    `row` [4, F] holds y and w; `gains` [2, F] are those of its slow noise; `x` [5, F] is room.
    """
    y0, y1, y2, w = row[0, first:stop], row[1, first:stop], row[2, first:stop], row[3, first:stop]
    x0, x1, x2, a = x[0, first:stop], x[1, first:stop], x[2, first:stop], x[3, first:stop]
    r0, r1, r2 = R[0, first:stop], R[1, first:stop], R[2, first:stop]
    r3, r4, r5 = R[3, first:stop], R[4, first:stop], R[5, first:stop]
    r6, r7, r8 = R[6, first:stop], R[7, first:stop], R[8, first:stop]
    t0, t1, t2, p = t[0, first:stop], t[1, first:stop], t[2, first:stop], posed[first:stop]
    seen, held = 0.0, 0.0
    for f in range(len(w)):
        z0, z1, z2 = y0[f] - t0[f], y1[f] - t1[f], y2[f] - t2[f]
        x0[f] = r0[f] * z0 + r3[f] * z1 + r6[f] * z2
        x1[f] = r1[f] * z0 + r4[f] * z1 + r7[f] * z2
        x2[f] = r2[f] * z0 + r5[f] * z1 + r8[f] * z2
        a[f] = w[f] * p[f]
        seen += 1.0 if w[f] > 0 else 0.0
        held += 1.0 if a[f] > 0 else 0.0
    missing = 0.5 * (dim if held >= LEAST_COVERED * seen else unposed) * (seen - held)
    if held == 0.0:
        return missing, 0.0
    soft, d2 = inverse / (SOFT * dim), x[4, first:stop]
    mean = _robust_mean(x, first, stop, soft)
    _squares(x, first, stop, mean, gains, persistence, soft, d2)
    paid, squared, most = 0.0, 0.0, cap * dim
    for f in range(len(w)):
        squared += d2[f]
        paid += min(d2[f] * inverse, most)
    return missing + 0.5 * paid, squared / held


@compiled()
def _robust_mean(x: Floats, first: int, stop: int, soft: float) -> tuple[float, float, float]:
    """Mean of points [4, first:stop], three coordinates and a weight.

    A squared distance of 1 / soft from the plain mean halves a weight.
    """
    x0, x1, x2, a = x[0, first:stop], x[1, first:stop], x[2, first:stop], x[3, first:stop]
    total, m0, m1, m2 = 1e-300, 0.0, 0.0, 0.0
    for f in range(len(a)):
        total += a[f]
        m0 += a[f] * x0[f]
        m1 += a[f] * x1[f]
        m2 += a[f] * x2[f]
    m0, m1, m2 = m0 / total, m1 / total, m2 / total
    total, b0, b1, b2 = 1e-300, 0.0, 0.0, 0.0
    for f in range(len(a)):
        d2 = (x0[f] - m0) ** 2 + (x1[f] - m1) ** 2 + (x2[f] - m2) ** 2
        g = a[f] / (1.0 + soft * a[f] * d2)
        total += g
        b0 += g * x0[f]
        b1 += g * x1[f]
        b2 += g * x2[f]
    return b0 / total, b1 / total, b2 / total


@compiled()
def _squares(
    x: Floats,
    first: int,
    stop: int,
    mean: tuple[float, float, float],
    gains: Floats,
    persistence: float,
    soft: float,
    squared: Floats,
) -> None:
    """Weighted squared distances of points [4, first:stop] from their mean, to [stop - first].

    With slow noise, of the innovations: the distance from what a Kalman filter of the slow noise expects
    (Kalman 1960). These are independent from frame to frame, and have the variance of the tolerance.
    """
    x0, x1, x2, a = x[0, first:stop], x[1, first:stop], x[2, first:stop], x[3, first:stop]
    gain, precision = gains[0, first:stop], gains[1, first:stop]
    if persistence == 0.0:
        for f in range(len(a)):
            d2 = (x0[f] - mean[0]) ** 2 + (x1[f] - mean[1]) ** 2 + (x2[f] - mean[2]) ** 2
            squared[f] = a[f] * d2
        return
    s0, s1, s2 = mean
    for f in range(len(a)):
        squared[f] = 0.0
        if a[f] > 0:
            e0, e1, e2 = x0[f] - s0, x1[f] - s1, x2[f] - s2
            squared[f] = a[f] * precision[f] * (e0 * e0 + e1 * e1 + e2 * e2)
            g = gain[f] / (1.0 + soft * squared[f])
            s0, s1, s2 = s0 + g * e0, s1 + g * e1, s2 + g * e2
        s0 = mean[0] + persistence * (s0 - mean[0])
        s1 = mean[1] + persistence * (s1 - mean[1])
        s2 = mean[2] + persistence * (s2 - mean[2])


@compiled()
def _filter_gains(w: Floats, spectrum: Floats, stride: int, gains: Floats) -> None:
    """Gain of a Kalman filter of a row's slow noise, and inverse variance of its innovations, to [2, F].

    The latter are in tolerances, and relative to the weight of the observation. `spectrum` [3] is that of
    :class:`~.records.RowArrays`, of frames `stride` times as dense as those of `w`.
    """
    white, slow, persistence = spectrum[0], spectrum[1], spectrum[2] ** stride
    if slow == 0.0:
        return
    variance = slow
    for f in range((len(w) + stride - 1) // stride):
        gain = variance * w[f] / (variance * w[f] + white)
        gains[0, f], gains[1, f] = gain, 1.0 / (variance * w[f] + white)
        variance -= gain * variance
        variance = persistence * persistence * variance + (1.0 - persistence * persistence) * slow
