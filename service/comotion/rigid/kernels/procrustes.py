"""Compiled: fits a template and its poses to rows, by generalised Procrustes with missing data."""

import numpy as np

from ...arrays import Floats
from ...compiled import compiled
from .metric import is_round_metric, quadratic
from .records import PoseArrays
from .rotation import closed_form, newton_rotation, planar_rotation, rotation_matrix

SOFT = 9.0
"""Squared residual, in tolerances per dimension, that halves the weight of an observation."""
# Pull towards the neighbouring frame's rotation, as a share of the moments. It settles what the points
# leave open, such as the turn of a pair about its own axis. Chosen on the scenes of
# docs/research/accuracy.md.
_PULL = 1e-3
# What keeps the equations of a pose regular: far above rounding, far below noise.
_SLIGHT_PULL = 1e-6


@compiled()
def fit_poses(
    y: Floats,
    w: Floats,
    inverse: Floats,
    metric: Floats,
    dim: int,
    iterations: int,
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
    b, poses
        Out: float64 [3, m], and the poses of the frames that have one.
    """
    R, t, posed = poses
    count, m = w.shape
    in_template = np.zeros(m)
    _seed(y, w, b, in_template)
    need = 2 if (dim == 2 or m <= 2) else 3
    started = np.zeros(count, np.bool_)
    weights, soft, identity = np.zeros(m), 1.0 / (SOFT * dim), np.eye(3)
    all_round = True
    for i in range(m):
        all_round &= is_round_metric(metric[i])
    for iteration in range(iterations):
        weighed = not all_round and iteration == iterations - 1
        sums, neighbour = np.zeros((4, m)), -1
        for f in range(count - 1, -1, -1):
            robust = soft if iteration > 0 and posed[f] else 0.0
            posed[f] = _weigh(y[f], w[f], inverse, b, in_template, R[f], t[f], robust, weights) >= need
            if posed[f]:
                near = R[neighbour] if neighbour >= 0 else identity
                # The frame's own rotation of the last iteration is nearer still than its neighbour's.
                start = R[f].copy() if iteration > 0 and started[f] else near
                frame_pose(y[f], b, weights, dim, near, start, neighbour >= 0, R[f], t[f])
                started[f] = True
                neighbour = f
                if weighed:
                    _step(y[f], weights, metric, b, dim, R[f], t[f])
                _collect(y[f], w[f], inverse, metric, b, in_template, R[f], t[f], soft, not weighed, sums)
        for i in range(m):
            if sums[3, i] > 0:
                in_template[i] = 1.0
                b[:, i] = sums[:3, i] / sums[3, i]
        if iteration < iterations - 1:
            _bridge(y, w, inverse, dim, need, b, in_template, poses)


@compiled()
def frame_pose(
    y: Floats,
    b: Floats,
    weights: Floats,
    dim: int,
    near: Floats,
    start: Floats,
    started: bool,
    R: Floats,
    t: Floats,
) -> None:
    """Weighted pose y = R b + t of one frame, its rotation pulled towards `near`, in place.

    By Newton's method from the rotation `start` if it has `started`; else, or if that fails, in closed form.
    """
    H, centres = np.zeros((3, 3)), np.zeros((2, 3))
    _moments(y, b, weights, centres, H)
    if dim == 2:
        planar_rotation(H, R)
    else:
        pull = _PULL * np.sqrt((H * H).sum())
        for p in range(3):
            for q in range(3):
                H[p, q] += pull * near[p, q]
        if not (started and newton_rotation(H, start, R)):
            closed_form(H, R)
    _translation(R, centres, t)


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
        _weigh(y[f], w[f], inverse, b, in_template, R[f], t[f], 0.0, weights)
        if held == 1:
            # One point has no moments to pull.
            H, centres = np.zeros((3, 3)), np.zeros((2, 3))
            _moments(y[f], b, weights, centres, H)
            R[f] = R[beside]
            _translation(R[f], centres, t[f])
        else:
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
def continue_poses(
    y: Floats,
    w: Floats,
    inverse: Floats,
    metric: Floats,
    dim: int,
    first: int,
    b: Floats,
    poses: PoseArrays,
) -> None:
    """Poses x = R b + t of a known template at frames from `first` on, each from the one before, in place.

    Parameters
    ----------
    y, w, inverse, metric
        As of :func:`fit_poses`, of the frames from `first` on only.
    first
        Frames before it have their poses.
    b, poses
        float64 [3, m], the template; the poses of all frames.
    """
    R, t, posed = poses
    m = w.shape[1]
    in_template, weights = np.ones(m), np.zeros(m)
    need = 2 if (dim == 2 or m <= 2) else 3
    soft, all_round = 1.0 / (SOFT * dim), True
    for i in range(m):
        all_round &= is_round_metric(metric[i])
    for f in range(len(w)):
        now, previous = first + f, first + f - 1
        R[now], t[now] = R[previous], t[previous]
        for robust in (0.0, soft, soft):
            posed[now] = _weigh(y[f], w[f], inverse, b, in_template, R[now], t[now], robust, weights) >= need
            if posed[now]:
                frame_pose(y[f], b, weights, dim, R[previous], R[previous], True, R[now], t[now])
        if posed[now] and not all_round:
            _step(y[f], weights, metric, b, dim, R[now], t[now])


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
def _weigh(
    y: Floats,
    w: Floats,
    inverse: Floats,
    b: Floats,
    in_template: Floats,
    R: Floats,
    t: Floats,
    soft: float,
    weights: Floats,
) -> int:
    """Weights [m] of a frame's points, by their residuals in its pose; how many are positive."""
    y0, y1, y2, b0, b1, b2 = y[0], y[1], y[2], b[0], b[1], b[2]
    count = 0
    for i in range(len(w)):
        r0 = y0[i] - t[0] - R[0, 0] * b0[i] - R[0, 1] * b1[i] - R[0, 2] * b2[i]
        r1 = y1[i] - t[1] - R[1, 0] * b0[i] - R[1, 1] * b1[i] - R[1, 2] * b2[i]
        r2 = y2[i] - t[2] - R[2, 0] * b0[i] - R[2, 1] * b1[i] - R[2, 2] * b2[i]
        a = w[i] * inverse[i] * in_template[i]
        weights[i] = a / (1.0 + soft * a * (r0 * r0 + r1 * r1 + r2 * r2))
        count += a > 0
    return count


@compiled()
def _moments(y: Floats, b: Floats, weights: Floats, centres: Floats, H: Floats) -> None:
    """Weighted means of y and b, [2, 3], and H = sum w (y - ybar)(b - bbar)^T."""
    y0, y1, y2, b0, b1, b2 = y[0], y[1], y[2], b[0], b[1], b[2]
    total, p0, p1, p2, q0, q1, q2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(weights)):
        a = weights[i]
        total += a
        p0 += a * y0[i]
        p1 += a * y1[i]
        p2 += a * y2[i]
        q0 += a * b0[i]
        q1 += a * b1[i]
        q2 += a * b2[i]
    p0, p1, p2, q0, q1, q2 = p0 / total, p1 / total, p2 / total, q0 / total, q1 / total, q2 / total
    centres[0, 0], centres[0, 1], centres[0, 2] = p0, p1, p2
    centres[1, 0], centres[1, 1], centres[1, 2] = q0, q1, q2
    h00, h01, h02, h10, h11, h12, h20, h21, h22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(weights)):
        u0, u1, u2 = weights[i] * (y0[i] - p0), weights[i] * (y1[i] - p1), weights[i] * (y2[i] - p2)
        v0, v1, v2 = b0[i] - q0, b1[i] - q1, b2[i] - q2
        h00 += u0 * v0
        h01 += u0 * v1
        h02 += u0 * v2
        h10 += u1 * v0
        h11 += u1 * v1
        h12 += u1 * v2
        h20 += u2 * v0
        h21 += u2 * v1
        h22 += u2 * v2
    H[0, 0], H[0, 1], H[0, 2] = h00, h01, h02
    H[1, 0], H[1, 1], H[1, 2] = h10, h11, h12
    H[2, 0], H[2, 1], H[2, 2] = h20, h21, h22


@compiled()
def _translation(R: Floats, centres: Floats, t: Floats) -> None:
    """Translation that takes the mean of b to that of y."""
    for c in range(3):
        t[c] = centres[0, c] - R[c, 0] * centres[1, 0] - R[c, 1] * centres[1, 1] - R[c, 2] * centres[1, 2]


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


@compiled()
def _step(y: Floats, weights: Floats, metric: Floats, b: Floats, dim: int, R: Floats, t: Floats) -> None:
    """One step of Gauss-Newton of a frame's pose: R exp([s]x), t + u, by residuals under their metrics."""
    left, right, J, MJ = np.zeros((6, 6)), np.zeros(6), np.zeros((3, 6)), np.zeros((3, 6))
    for i in range(len(weights)):
        if weights[i] > 0:
            _derivatives(b[:, i], R, metric[i], J, MJ)
            for c in range(3):
                r = y[c, i] - t[c] - R[c, 0] * b[0, i] - R[c, 1] * b[1, i] - R[c, 2] * b[2, i]
                for p in range(6):
                    right[p] += weights[i] * MJ[c, p] * r
                    for q in range(6):
                        left[p, q] += weights[i] * MJ[c, p] * J[c, q]
    turns = left[0, 0] + left[1, 1] + left[2, 2]
    for p in range(6):
        # What the points leave open stays as it is; in 2-D all but a turn about z and a shift in the plane.
        left[p, p] += (_PULL * turns if p < 3 else _SLIGHT_PULL * left[p, p]) + 1e-300
        if dim == 2 and p in (0, 1, 5):
            left[p, :] = 0.0
            left[:, p] = 0.0
            left[p, p], right[p] = 1.0, 0.0
    step = np.linalg.solve(left, right).astype(np.float64)
    turn, old = rotation_matrix(step[:3]), R.copy()
    for c in range(3):
        t[c] += step[3 + c]
        for d in range(3):
            R[c, d] = old[c, 0] * turn[0, d] + old[c, 1] * turn[1, d] + old[c, 2] * turn[2, d]


@compiled()
def _derivatives(b: Floats, R: Floats, m: Floats, J: Floats, MJ: Floats) -> None:
    """J = [-R [b]x, 1], the derivative of R exp([s]x) b + t, and M J by a metric [6], to [3, 6] each."""
    for c in range(3):
        J[c, 0] = R[c, 2] * b[1] - R[c, 1] * b[2]
        J[c, 1] = R[c, 0] * b[2] - R[c, 2] * b[0]
        J[c, 2] = R[c, 1] * b[0] - R[c, 0] * b[1]
        J[c, 3 + c] = 1.0
    for q in range(6):
        MJ[0, q] = m[0] * J[0, q] + m[1] * J[1, q] + m[2] * J[2, q]
        MJ[1, q] = m[1] * J[0, q] + m[3] * J[1, q] + m[4] * J[2, q]
        MJ[2, q] = m[2] * J[0, q] + m[4] * J[1, q] + m[5] * J[2, q]
