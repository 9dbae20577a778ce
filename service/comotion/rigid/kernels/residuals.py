"""Compiled: cost of each row under each body, from its residuals in the frame of the body."""

import numpy as np

from ...arrays import Floats, Slots
from ...compiled import compiled
from .metric import is_round_metric, squared_length
from .procrustes import SOFT
from .records import RowArrays

LEAST_COVERED = 0.6
"""Share of a row's frames in which a body must be posed to be charged the expected residual elsewhere."""


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
        float64 [K, F, 13], of :func:`~comotion.rigid.costs.stacked`.
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
    y, w, tolerance, spectrum, metric = arrays
    x, gains = np.empty((w.shape[1], 5)), np.empty((w.shape[1], 2))
    soft_gains, mixed = np.empty((w.shape[1], 2)), np.empty(3)
    for n in range(len(rows)):
        i = rows[n]
        span, terms, inverse = observed_span(w[i]), (dim, cap, unposed), 1.0 / tolerance[i]
        _filter_gains(w[i], spectrum[i], gains)
        for k in range(len(poses)):
            soft = deformation[0][k] * inverse
            if soft == 0.0:
                noise = inverse, metric[i], spectrum[i, 2]
                cost[n, k], squared[n, k] = _body_cost(y[i], w[i], poses[k], span, noise, terms, x, gains)
                continue
            slow = spectrum[i, 1] + soft
            mixed[0], mixed[1] = spectrum[i, 0], slow
            mixed[2] = (spectrum[i, 1] * spectrum[i, 2] + soft * deformation[1]) / slow
            _filter_gains(w[i], mixed, soft_gains)
            noise = inverse, metric[i], mixed[2]
            cost[n, k], squared[n, k] = _body_cost(y[i], w[i], poses[k], span, noise, terms, x, soft_gains)
            cost[n, k] += 0.5 * dim * _log_ratio(w[i], poses[k], span, gains, soft_gains)


@compiled()
def _log_ratio(w: Floats, poses: Floats, span: tuple[int, int], gains: Floats, soft_gains: Floats) -> float:
    """Log of the product of the variances of innovations, with deformation over without, in posed frames."""
    total, product = 0.0, 1.0
    for f in range(span[0], span[1]):
        if w[f] * poses[f, 12] > 0:
            product *= gains[f, 1] / soft_gains[f, 1]
            # Far from overflow; a logarithm takes far longer than a product.
            if product > 1e100:
                total, product = total + np.log(product), 1.0
    return float(total + np.log(product))


@compiled()
def recent_residuals(
    arrays: RowArrays,
    body: Slots,
    poses: Floats,
    soft: Floats,
    span: tuple[int, int],
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
        variance, is_round = (tolerance[i] + soft[k]) * (1.0 + 1.0 / total), is_round_metric(metric[i])
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
def _body_cost(
    y: Floats,
    w: Floats,
    poses: Floats,
    span: tuple[int, int],
    noise: tuple[float, Floats, float],
    terms: tuple[int, float, float],
    x: Floats,
    gains: Floats,
) -> tuple[float, float]:
    """Cost of one row under one body at some frames, and its mean squared residual.

    Parameters
    ----------
    y, w, poses
        float64 [F, 3], [F] and [F, 13].
    span, noise, terms
        First frame and one past the last; inverse tolerance, metric [6] and persistence of the row;
        dimension, cap and price of a frame without a pose.
    x, gains
        float64 [F, 5], room, and [F, 2], of :func:`_filter_gains`.
    """
    (first, stop), (inverse, metric, persistence), (dim, cap, unposed) = span, noise, terms
    seen, held, count = 0.0, 0.0, stop - first
    for f in range(count):
        _in_body(y[first + f], poses[first + f], x[f])
        x[f, 3] = w[first + f] * poses[first + f, 12]
        seen += 1.0 if w[first + f] > 0 else 0.0
        held += 1.0 if x[f, 3] > 0 else 0.0
    missing = 0.5 * (dim if held >= LEAST_COVERED * seen else unposed) * (seen - held)
    if held == 0.0:
        return missing, 0.0
    shape = metric, is_round_metric(metric), inverse / (SOFT * dim)
    mean = _robust_mean(x, count, poses[first:], shape)
    _squares(x, count, poses[first:], mean, gains[first:], persistence, shape)
    paid, squared, most = 0.0, 0.0, cap * dim
    for f in range(count):
        squared += x[f, 4]
        paid += min(x[f, 4] * inverse, most)
    return missing + 0.5 * paid, squared / held


@compiled()
def _robust_mean(
    x: Floats, count: int, poses: Floats, shape: tuple[Floats, bool, float]
) -> tuple[float, float, float]:
    """Mean of points [count, 4 or more], three coordinates and a weight, in the frame of a body.

    A squared distance of 1 / soft from the plain mean halves a weight. `shape` is the metric [6], whether it
    is round, and soft.
    """
    metric, is_round, soft = shape
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
    shape: tuple[Floats, bool, float],
) -> None:
    """Weighted squared distances of points [count, 5] from their mean, to the last column.

    With slow noise, of the innovations: the distance from what a Kalman filter of the slow noise expects
    (Kalman 1960). These are independent from frame to frame, and have the variance of the tolerance.
    """
    (metric, is_round, soft), (s0, s1, s2) = shape, mean
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
def _filter_gains(w: Floats, spectrum: Floats, gains: Floats) -> None:
    """Gain of a Kalman filter of a row's slow noise, and inverse variance of its innovations, to [F, 2].

    The latter are in tolerances, and relative to the weight of the observation. `spectrum` [3] is that of
    :class:`~.records.RowArrays`.
    """
    white, slow, persistence = spectrum[0], spectrum[1], spectrum[2]
    if slow == 0.0:
        gains[:, 0], gains[:, 1] = 0.0, 1.0 / white
        return
    variance = slow
    for k in range(len(w)):
        a = w[k]
        gains[k, 1] = 1.0 / (variance * a + white)
        gains[k, 0] = gain = variance * a * gains[k, 1]
        variance -= gain * variance
        variance = persistence * persistence * variance + (1.0 - persistence * persistence) * slow
