"""Compiled: fits the pose of a body in one frame to the rows that are seen there."""

import numpy as np

from ..arrays import Floats
from ..compiled import compiled
from .rotation import closed_form, newton_rotation, rotation_matrix

# Pull towards the neighbouring frame's rotation, as a share of the moments. It settles what the points
# leave open, such as the turn of a pair about its own axis. Chosen on the scenes of
# docs/research/accuracy.md.
_PULL = 1e-3


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
    moments(y, b, weights, centres, H)
    size = np.sqrt((H * H).sum()) or 1.0
    for p in range(3):
        for q in range(3):
            H[p, q] += _PULL * size * near[p, q]
    if dim == 2:
        # The largest moment keeps the axis where it is.
        H[2, 2] += size
    if not (started and newton_rotation(H, start, R)):
        closed_form(H, R)
    translation(R, centres, t)


@compiled()
def weigh(
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
def moments(y: Floats, b: Floats, weights: Floats, centres: Floats, H: Floats) -> None:
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
def translation(R: Floats, centres: Floats, t: Floats) -> None:
    """Translation that takes the mean of b to that of y."""
    for c in range(3):
        t[c] = centres[0, c] - R[c, 0] * centres[1, 0] - R[c, 1] * centres[1, 1] - R[c, 2] * centres[1, 2]


@compiled()
def newton_step(
    y: Floats, weights: Floats, metric: Floats, b: Floats, dim: int, R: Floats, t: Floats
) -> None:
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
        left[p, p] += _PULL * (turns if p < 3 else left[p, p]) + 1e-300
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
