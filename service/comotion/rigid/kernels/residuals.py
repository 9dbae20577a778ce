"""Compiled: in rows and the poses of bodies, out the cost of each row under each body."""

import numpy as np

from ...arrays import Bools, Floats, Slots
from ...compiled import compiled
from .metric import is_round_metric, squared_length
from .procrustes import SOFT
from .records import RowArrays

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
    poses: Floats,
    wider: Floats,
    unposed: float,
    dim: int,
    cap: float,
    stride: int,
    cost: Floats,
    squared: Floats,
    gain: Floats,
) -> None:
    """Cost of rows under each body, 1/2 sum_f min(w |x - b|^2 / v, cap dim), in place.

    x is the row in the body's frame, b its robust mean there.

    Parameters
    ----------
    rows
        intp [n], rows to take.
    poses
        float64 [K, F, 13], of :func:`~comotion.rigid.costs.stacked`.
    wider
        float64 [K], by how much the tolerance of a body exceeds that of a row: v = tolerance + wider.
    unposed
        Twice the cost of a frame without a pose where a body covers little of a row. Where it covers most
        frames of the row, the others cost the expected residual.
    stride
        Above 1: estimate on every stride-th frame first, and take all frames only for the bodies whose
        estimate is near the least. The others keep their estimate.
    cost
        Out: float64 [n, K], in nats.
    squared
        Out: float64 [n, K], the mean of w |x - b|^2 over posed frames.
    gain
        Out, where the first body is the static one: float64 [n, K], what a row would gain at rest by the
        wider tolerance of each body whose cost is no estimate. Else empty.
    """
    y, w, tolerance, spectrum, metric = arrays
    count, bodies = w.shape[1], len(poses)
    row, x, gains = np.empty((count, 4)), np.empty((count, 5)), np.empty((count, 2))
    some, asked = np.ascontiguousarray(poses[:, ::stride]), np.ones(bodies, np.bool_)
    for n in range(len(rows)):
        i = rows[n]
        first, stop = observed_span(w[i])
        scale = tolerance[i], wider, dim, cap, unposed
        asked[:] = True
        if stride > 1 and stop - first >= _LEAST_ESTIMATE_FRAMES * stride:
            seen, persistence = _copy_row(y[i], w[i], stride, row), spectrum[i, 2] ** stride
            _filter_gains(w[i], spectrum[i], stride, gains)
            span, noise = (0, some.shape[1]), (metric[i], persistence)
            _row_costs(row, some, span, asked, scale, noise, x, gains, cost[n], squared[n])
            if seen > 0:
                _keep_near(cost[n], asked, _copy_row(y[i], w[i], 1, row) / seen)
        _copy_row(y[i], w[i], 1, row)
        _filter_gains(w[i], spectrum[i], 1, gains)
        loose = False
        for k in range(bodies):
            loose |= gain.size > 0 and asked[k] and wider[k] > 0
        # The gain by a wider tolerance follows from the residuals at rest.
        asked[0] |= loose
        span, noise = (first, stop), (metric[i], spectrum[i, 2])
        _row_costs(row, poses, span, asked, scale, noise, x, gains, cost[n], squared[n])
        for k in range(1, bodies):
            if loose and asked[k] and wider[k] > 0:
                gain[n, k] = _wider_gain(x, stop - first, tolerance[i], wider[k], cap * dim)


@compiled()
def _keep_near(cost: Floats, asked: Bools, factor: float) -> None:
    """Scale the estimates [K] that were asked for, and ask on for those that are near the least."""
    least = np.inf
    for k in range(len(cost)):
        if asked[k]:
            cost[k] *= factor
        least = min(least, cost[k])
    for k in range(len(cost)):
        asked[k] = asked[k] and cost[k] < _NEAR_FACTOR * least + _NEAR_NATS


@compiled()
def _row_costs(
    row: Floats,
    poses: Floats,
    span: tuple[int, int],
    asked: Bools,
    scale: tuple[float, Floats, int, float, float],
    noise: tuple[Floats, float],
    x: Floats,
    gains: Floats,
    cost: Floats,
    squared: Floats,
) -> None:
    """Cost and mean squared residual of a row under the bodies that are asked for, the first body last."""
    (tolerance, wider, dim, cap, unposed), (metric, persistence), (first, stop) = scale, noise, span
    for k in range(len(poses) - 1, -1, -1):
        if asked[k]:
            inverse = 1.0 / (tolerance + wider[k])
            cost[k], squared[k] = _body_cost(
                row, poses[k], first, stop, inverse, dim, cap, unposed, metric, x, gains, persistence
            )


@compiled()
def _wider_gain(x: Floats, count: int, tolerance: float, wider: float, most: float) -> float:
    """By how much the squares in the last column of x [count, 5] cost less at a wider tolerance."""
    gain, narrow, wide = 0.0, 1.0 / tolerance, 1.0 / (tolerance + wider)
    for f in range(count):
        gain += min(x[f, 4] * narrow, most) - min(x[f, 4] * wide, most)
    return 0.5 * gain


@compiled()
def own_residuals(
    arrays: RowArrays,
    rows: Slots,
    first: Slots,
    poses: Floats,
    dim: int,
    most: float,
    excess: Floats,
) -> None:
    """How well each body fits the rows that it was fitted to, in place.

    Parameters
    ----------
    rows, first
        intp [n] and [K + 1]; rows[first[k]:first[k + 1]] are those of body k.
    poses
        As of :func:`body_costs`.
    excess
        Out: float64 [K], mean squared residual in tolerances and dimensions, that of each row at most `most`.
    """
    y, w, tolerance, spectrum, metric = arrays
    count = w.shape[1]
    row, x, gains = np.empty((count, 4)), np.empty((count, 5)), np.empty((count, 2))
    for k in range(len(poses)):
        for n in range(first[k], first[k + 1]):
            i = rows[n]
            _copy_row(y[i], w[i], 1, row)
            inverse = 1.0 / tolerance[i]
            _filter_gains(w[i], spectrum[i], 1, gains)
            _, squared = _body_cost(
                row, poses[k], 0, count, inverse, dim, 1.0, 0.0, metric[i], x, gains, spectrum[i, 2]
            )
            excess[k] += min(squared * inverse / dim, most) / (first[k + 1] - first[k])


@compiled()
def recent_residuals(
    arrays: RowArrays,
    body: Slots,
    poses: Floats,
    wider: Floats,
    span: tuple[int, int],
    squared: Floats,
    count: Floats,
) -> None:
    """How far each row is at the newest frames from its mean before them, in the frame of its body, in place.

    Parameters
    ----------
    body
        intp [P], body of each row; below 0 for none.
    poses, wider
        As of :func:`body_costs`.
    span
        First frame of the mean, and one past the last: the frames after it are judged.
    squared, count
        Out: float64 [P] each, sum of the squared distances in tolerances, and number of frames.
    """
    y, w, tolerance, _, metric = arrays
    (first, split), x = span, np.zeros(3)
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
        variance, is_round = (tolerance[i] + wider[k]) * (1.0 + 1.0 / total), is_round_metric(metric[i])
        for f in range(split, w.shape[1]):
            a = w[i, f] * poses[k, f, 12]
            if a > 0:
                _in_body(y[i, f], poses[k, f], x)
                e0, e1, e2 = x[0] - m0 / total, x[1] - m1 / total, x[2] - m2 / total
                d2 = squared_length(metric[i], poses[k, f], e0, e1, e2, is_round)
                squared[i] += a * d2 / variance
                count[i] += 1.0


@compiled()
def _in_body(y: Floats, pose: Floats, x: Floats) -> None:
    """A point [3] in the frame of a body with a pose [13], to x [3]."""
    z0, z1, z2 = y[0] - pose[9], y[1] - pose[10], y[2] - pose[11]
    for c in range(3):
        x[c] = pose[c] * z0 + pose[3 + c] * z1 + pose[6 + c] * z2


@compiled()
def observed_span(w: Floats) -> tuple[int, int]:
    """First frame in which a row is observed, and one past the last."""
    first, stop = 0, len(w)
    while first < stop and w[first] <= 0:
        first += 1
    while stop > first and w[stop - 1] <= 0:
        stop -= 1
    return first, stop


@compiled()
def _copy_row(y: Floats, w: Floats, stride: int, row: Floats) -> int:
    """Copy every stride-th frame of a row to [F, 4]; return in how many of them it is observed."""
    seen = 0
    for f in range(0, len(w), stride):
        k = f // stride
        row[k, 0], row[k, 1], row[k, 2], row[k, 3] = y[f, 0], y[f, 1], y[f, 2], w[f]
        seen += w[f] > 0
    return seen


@compiled()
def _body_cost(
    row: Floats,
    poses: Floats,
    first: int,
    stop: int,
    inverse: float,
    dim: int,
    cap: float,
    unposed: float,
    metric: Floats,
    x: Floats,
    gains: Floats,
    persistence: float,
) -> tuple[float, float]:
    """Cost of one row under one body at frames [first:stop], and its mean squared residual.

    `row` [F, 4] holds y and w, `poses` [F, 13] those of the body, `metric` [6] that of the noise; `gains`
    [F, 2] are those of the row's slow noise; `x` [F, 5] is room.
    """
    seen, held, count = 0.0, 0.0, stop - first
    is_round = is_round_metric(metric)
    for f in range(count):
        p, r = poses[first + f], row[first + f]
        z0, z1, z2 = r[0] - p[9], r[1] - p[10], r[2] - p[11]
        x[f, 0] = p[0] * z0 + p[3] * z1 + p[6] * z2
        x[f, 1] = p[1] * z0 + p[4] * z1 + p[7] * z2
        x[f, 2] = p[2] * z0 + p[5] * z1 + p[8] * z2
        x[f, 3] = r[3] * p[12]
        seen += 1.0 if r[3] > 0 else 0.0
        held += 1.0 if x[f, 3] > 0 else 0.0
    missing = 0.5 * (dim if held >= LEAST_COVERED * seen else unposed) * (seen - held)
    if held == 0.0:
        return missing, 0.0
    soft = inverse / (SOFT * dim)
    noise = metric, is_round, soft
    mean = _robust_mean(x, count, poses[first:], noise)
    _squares(x, count, poses[first:], mean, gains[first:], persistence, noise)
    paid, squared, most = 0.0, 0.0, cap * dim
    for f in range(count):
        squared += x[f, 4]
        paid += min(x[f, 4] * inverse, most)
    return missing + 0.5 * paid, squared / held


@compiled()
def _robust_mean(
    x: Floats, count: int, poses: Floats, noise: tuple[Floats, bool, float]
) -> tuple[float, float, float]:
    """Mean of points [count, 4 or more], three coordinates and a weight, in the frame of a body.

    A squared distance of 1 / soft from the plain mean halves a weight. `noise` is the metric [6], whether it
    is round, and soft.
    """
    metric, is_round, soft = noise
    total, m0, m1, m2 = 1e-300, 0.0, 0.0, 0.0
    for f in range(count):
        a = x[f, 3]
        total += a
        m0 += a * x[f, 0]
        m1 += a * x[f, 1]
        m2 += a * x[f, 2]
    m0, m1, m2 = m0 / total, m1 / total, m2 / total
    total, b0, b1, b2 = 1e-300, 0.0, 0.0, 0.0
    for f in range(count):
        d2 = squared_length(metric, poses[f], x[f, 0] - m0, x[f, 1] - m1, x[f, 2] - m2, is_round)
        g = x[f, 3] / (1.0 + soft * x[f, 3] * d2)
        total += g
        b0 += g * x[f, 0]
        b1 += g * x[f, 1]
        b2 += g * x[f, 2]
    return b0 / total, b1 / total, b2 / total


@compiled()
def _squares(
    x: Floats,
    count: int,
    poses: Floats,
    mean: tuple[float, float, float],
    gains: Floats,
    persistence: float,
    noise: tuple[Floats, bool, float],
) -> None:
    """Weighted squared distances of points [count, 5] from their mean, to the last column.

    With slow noise, of the innovations: the distance from what a Kalman filter of the slow noise expects
    (Kalman 1960). These are independent from frame to frame, and have the variance of the tolerance.
    """
    (metric, is_round, soft), (s0, s1, s2) = noise, mean
    for f in range(count):
        x[f, 4] = 0.0
        if x[f, 3] > 0:
            e0, e1, e2 = x[f, 0] - s0, x[f, 1] - s1, x[f, 2] - s2
            x[f, 4] = x[f, 3] * squared_length(metric, poses[f], e0, e1, e2, is_round)
            if persistence > 0.0:
                x[f, 4] *= gains[f, 1]
                g = gains[f, 0] / (1.0 + soft * x[f, 4])
                s0, s1, s2 = s0 + g * e0, s1 + g * e1, s2 + g * e2
        if persistence > 0.0:
            s0 = mean[0] + persistence * (s0 - mean[0])
            s1 = mean[1] + persistence * (s1 - mean[1])
            s2 = mean[2] + persistence * (s2 - mean[2])


@compiled()
def _filter_gains(w: Floats, spectrum: Floats, stride: int, gains: Floats) -> None:
    """Gain of a Kalman filter of a row's slow noise, and inverse variance of its innovations, to [F, 2].

    The latter are in tolerances, and relative to the weight of the observation. `spectrum` [3] is that of
    :class:`~.records.RowArrays`, of frames as dense as those of `w`; every stride-th is taken.
    """
    white, slow, persistence = spectrum[0], spectrum[1], spectrum[2] ** stride
    if slow == 0.0:
        return
    variance = slow
    for k in range((len(w) + stride - 1) // stride):
        a = w[k * stride]
        gain = variance * a / (variance * a + white)
        gains[k, 0], gains[k, 1] = gain, 1.0 / (variance * a + white)
        variance -= gain * variance
        variance = persistence * persistence * variance + (1.0 - persistence * persistence) * slow
