"""Compiled: fits a template and its poses to rows, by generalised Procrustes with missing data."""

import numpy as np

from ..arrays import Floats
from ..compiled import compiled
from .frame_pose import frame_pose, newton_step, weigh
from .records import PoseArrays, is_round_metric, quadratic

SOFT = 9.0
"""Squared residual, in tolerances per dimension, that halves the weight of an observation."""


@compiled()
def fit_poses(
    y: Floats,
    w: Floats,
    inverse: Floats,
    metric: Floats,
    dim: int,
    near: Floats,
    iterations: int,
    known: bool,
    b: Floats,
    poses: PoseArrays,
) -> None:
    """Fit a template b and poses x = R b + t to rows, in place.

    The template begins as the frame with most rows. Each iteration fits the poses to the rows of the
    template, newest frame first, then the template to the poses, with weights 1 / (1 + r^2 / (9 dim v)).
    Where the noise of a row is not the same in all directions, a step of Gauss-Newton with its metric ends
    the fit of each pose.

    Parameters
    ----------
    y, w, inverse, metric
        float64 [F, 3, m], [F, m] (0: unobserved) and [m], inverse tolerance 1 / v, and [m, 6], of
        :class:`~.records.RowArrays`.
    near
        float64 [3, 3], a rotation near that of the newest frame.
    known
        Whether the template stays as it is.
    b, poses
        Out: float64 [3, m], and the poses of the frames that have one.
    """
    R, t, posed = poses
    count, m = w.shape
    in_template = np.ones(m) if known else np.zeros(m)
    if not known:
        _seed(y, w, b, in_template)
    need = min(m, dim)
    started = np.zeros(count, np.bool_)
    weights, soft = np.zeros(m), 1.0 / (SOFT * dim)
    all_round = True
    for i in range(m):
        all_round &= is_round_metric(metric[i])
    for iteration in range(iterations):
        weighed = not all_round and iteration == iterations - 1
        sums, neighbour, has_near = np.zeros((4, m)), near, known
        for f in range(count - 1, -1, -1):
            robust = soft if iteration > 0 and posed[f] else 0.0
            posed[f] = weigh(y[f], w[f], inverse, b, in_template, R[f], t[f], robust, weights) >= need
            if posed[f]:
                # The frame's own rotation of the last iteration is nearer still than its neighbour's.
                start = R[f].copy() if iteration > 0 and started[f] else neighbour
                frame_pose(y[f], b, weights, dim, neighbour, start, has_near, R[f], t[f])
                started[f] = has_near = True
                neighbour = R[f]
                if weighed:
                    newton_step(y[f], weights, metric, b, dim, R[f], t[f])
                _collect(y[f], w[f], inverse, metric, b, in_template, R[f], t[f], soft, not weighed, sums)
        if not known:
            _take_means(sums, b, in_template)
            if iteration < iterations - 1:
                _bridge(y, w, inverse, dim, need, b, in_template, poses)


@compiled()
def _bridge(
    y: Floats,
    w: Floats,
    inverse: Floats,
    dim: int,
    need: int,
    b: Floats,
    in_template: Floats,
    poses: PoseArrays,
) -> None:
    """Carry the template over a frame in which too few of its rows are seen, in place.

    Where nearly all features of a body are lost at once, those that are left open a rotation. No row that it
    would move is seen on both sides: the nearest to that of the neighbouring frame is as good as any.
    """
    R, t, posed = poses
    count, m = w.shape
    for f in range(count - 1, -1, -1):
        beside = f - 1 if f > 0 and posed[f - 1] else f + 1
        if posed[f] or beside == count or not posed[beside]:
            continue
        seen, held = 0, 0
        for i in range(m):
            seen += w[f, i] > 0
            held += w[f, i] > 0 and in_template[i] > 0
        if seen < need or held == 0 or held >= need:
            continue
        weights = np.zeros(m)
        weigh(y[f], w[f], inverse, b, in_template, R[f], t[f], 0.0, weights)
        # One point has no moments: the pull alone gives the rotation.
        frame_pose(y[f], b, weights, dim, R[beside], R[beside], True, R[f], t[f])
        for i in range(m):
            if w[f, i] > 0 and in_template[i] == 0:
                in_template[i] = 1.0
                for c in range(3):
                    b[c, i] = 0.0
                    for d in range(3):
                        b[c, i] += R[f, d, c] * (y[f, d, i] - t[f, d])
        return


@compiled()
def _seed(y: Floats, w: Floats, b: Floats, in_template: Floats) -> None:
    """Template of the rows that are observed in the frame with most rows, the newest of equals."""
    best, most = 0, 0
    for f in range(len(w) - 1, -1, -1):
        count = 0
        for i in range(w.shape[1]):
            count += w[f, i] > 0
        if count > most:
            best, most = f, count
    for i in range(w.shape[1]):
        if w[best, i] > 0:
            in_template[i] = 1.0
            for c in range(3):
                b[c, i] = y[best, c, i]


@compiled()
def _take_means(sums: Floats, b: Floats, in_template: Floats) -> None:
    """Take the weighted means of rows, from their sums [4, m], for the template."""
    for i in range(len(in_template)):
        if sums[3, i] > 0:
            in_template[i] = 1.0
            b[:, i] = sums[:3, i] / sums[3, i]


@compiled()
def _collect(
    y: Floats,
    w: Floats,
    inverse: Floats,
    metric: Floats,
    b: Floats,
    in_template: Floats,
    R: Floats,
    t: Floats,
    soft: float,
    is_round: bool,
    sums: Floats,
) -> None:
    """Add a frame's points, in the body's frame, to the weighted sums [4, m] of the template."""
    y0, y1, y2, b0, b1, b2 = y[0], y[1], y[2], b[0], b[1], b[2]
    s0, s1, s2, s3 = sums[0], sums[1], sums[2], sums[3]
    for i in range(len(w)):
        z0, z1, z2 = y0[i] - t[0], y1[i] - t[1], y2[i] - t[2]
        x0 = R[0, 0] * z0 + R[1, 0] * z1 + R[2, 0] * z2
        x1 = R[0, 1] * z0 + R[1, 1] * z1 + R[2, 1] * z2
        x2 = R[0, 2] * z0 + R[1, 2] * z1 + R[2, 2] * z2
        e0, e1, e2 = x0 - b0[i], x1 - b1[i], x2 - b2[i]
        if is_round:
            r2 = e0 * e0 + e1 * e1 + e2 * e2
        else:
            u, v = R[0, 0] * e0 + R[0, 1] * e1 + R[0, 2] * e2, R[1, 0] * e0 + R[1, 1] * e1 + R[1, 2] * e2
            r2 = quadratic(metric[i], u, v, R[2, 0] * e0 + R[2, 1] * e1 + R[2, 2] * e2)
        a = w[i] * inverse[i]
        a /= 1.0 + soft * in_template[i] * r2 * a
        s0[i] += a * x0
        s1[i] += a * x1
        s2[i] += a * x2
        s3[i] += a
