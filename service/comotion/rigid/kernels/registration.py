"""Compiled: in rows and a body's poses, out equations for the source's rotation, shift and delay."""

import numpy as np

from ...arrays import Floats, Ints
from ...compiled import compiled
from .records import PoseArrays, RowArrays

REGISTRATION_UNKNOWNS = 7
"""Unknowns: rotation vector, shift and delay."""
# Unknowns of the error of a pose, and what is added to the mean of their information where it is singular.
_POSE = 6
_SINGULAR_RIDGE = 1e-9


@compiled()
def normal_equations(
    arrays: RowArrays,
    seconds: Floats,
    rows: Ints,
    poses: PoseArrays,
    information: Floats,
    pivot: Floats,
    dim: int,
    least: int,
    left: Floats,
    right: Floats,
) -> tuple[float, float]:
    """Add the normal equations of rows that should be constant in the frame of one body.

    z = R^T (y - t) has the derivative R^T [omega x (y - pivot) + shift + velocity delay]. The place of a row
    in the body is unknown, so only departures from its mean count. The errors of the poses are common to the
    rows: they are unknowns of each frame, and eliminated (Schur complement).

    Parameters
    ----------
    seconds
        float64 [F], times of the frames.
    rows
        intp [n], rows to take.
    information
        float64 [F, 6, 6], of :func:`pose_information`.
    pivot
        float64 [3], centre of the rotation.
    dim, least
        2 or 3; rows with fewer frames are left out.
    left, right
        In and out: float64 [7, 7] and [7], to which the equations are added.

    Returns
    -------
    The squared residual before the step, in units of the rows' variances, and the coordinates it is the sum
    of, less those that the poses take up.
    """
    y, w, tolerance, _, _ = arrays
    R, t, posed = poses
    squared, coordinates = 0.0, 0.0
    seen = np.empty(len(seconds), np.intp)
    design, z = np.empty((len(seconds), 3, REGISTRATION_UNKNOWNS)), np.empty((len(seconds), 3))
    pose, cross = information.copy(), np.zeros((len(seconds), _POSE, REGISTRATION_UNKNOWNS + 1))
    for n in range(len(rows)):
        i, count = rows[n], 0
        for f in range(len(seconds)):
            if w[i, f] > 0 and posed[f]:
                seen[count] = f
                count += 1
        if count < least:
            continue
        for j in range(count):
            f = seen[j]
            _columns(y[i], seconds, seen[:count], j, R[f], pivot, design[j])
            _place(y[i, f], R[f], t[f], z[j])
        middle = _add(design[:count], z[:count], 1.0 / tolerance[i], left, right)
        squared += middle[3]
        J = _pose_columns(middle, dim)
        for j in range(count):
            _add_pose(design[j], z[j], J, 1.0 / tolerance[i], pose[seen[j]], cross[seen[j]])
        coordinates += dim * count
    for f in range(len(seconds)):
        if cross[f].any():
            taken, fewer = _eliminate(information[f], pose[f], cross[f], left, right)
            squared -= taken
            coordinates -= fewer
    return squared, coordinates


@compiled()
def pose_information(arrays: RowArrays, rows: Ints, template: Floats, dim: int, information: Floats) -> None:
    """Add the inverse covariance of the errors of a body's poses, in the frame of the body.

    Parameters
    ----------
    rows, template
        intp [m] and float64 [m, 3], the rows that the body was fitted to, and where they are in it.
    dim
        2 or 3.
    information
        In and out: float64 [F, 6, 6], rotation vector and shift.
    """
    _, w, tolerance, _, _ = arrays
    for m in range(len(rows)):
        J = _pose_columns(template[m], dim)
        once = J.T @ J / tolerance[rows[m]]
        for f in range(w.shape[1]):
            if w[rows[m], f] > 0:
                information[f] += once


@compiled()
def _pose_columns(b: Floats, dim: int) -> Floats:
    """Derivative of a point b [3] by a small rotation and shift, [3, 6]; zero in coordinates that are not."""
    J = np.zeros((3, _POSE))
    J[0, 1], J[0, 2], J[1, 0], J[1, 2], J[2, 0], J[2, 1] = b[2], -b[1], -b[2], b[0], b[1], -b[0]
    for c in range(3):
        J[c, 3 + c] = 1.0
    J[dim:] = 0.0
    return J


@compiled()
def _add_pose(A: Floats, r: Floats, J: Floats, inverse: float, pose: Floats, cross: Floats) -> None:
    """Add a centred row at one frame: J^T J to `pose` [6, 6], J^T [A r] to `cross` [6, 8]."""
    for p in range(_POSE):
        for c in range(3):
            a = J[c, p] * inverse
            if a == 0.0:
                continue
            for q in range(_POSE):
                pose[p, q] += a * J[c, q]
            for q in range(REGISTRATION_UNKNOWNS):
                cross[p, q] += a * A[c, q]
            cross[p, REGISTRATION_UNKNOWNS] += a * r[c]


@compiled()
def _eliminate(
    before: Floats, pose: Floats, cross: Floats, left: Floats, right: Floats
) -> tuple[float, float]:
    """Take the pose of a frame out of the equations; return the squared residual and coordinates it takes."""
    both = np.empty((_POSE, REGISTRATION_UNKNOWNS + 1 + _POSE))
    both[:, : REGISTRATION_UNKNOWNS + 1] = cross
    both[:, REGISTRATION_UNKNOWNS + 1 :] = pose - before
    regular = pose + _SINGULAR_RIDGE * np.trace(pose) / _POSE * np.eye(_POSE)
    solved = np.linalg.solve(regular, both)
    taken = cross.T @ np.ascontiguousarray(solved[:, : REGISTRATION_UNKNOWNS + 1])
    left -= taken[:REGISTRATION_UNKNOWNS, :REGISTRATION_UNKNOWNS]
    right += taken[:REGISTRATION_UNKNOWNS, REGISTRATION_UNKNOWNS]
    return taken[REGISTRATION_UNKNOWNS, REGISTRATION_UNKNOWNS], np.trace(
        solved[:, REGISTRATION_UNKNOWNS + 1 :]
    )


@compiled()
def _place(y: Floats, R: Floats, t: Floats, z: Floats) -> None:
    """R^T (y - t), into z [3]."""
    for c in range(3):
        z[c] = 0.0
        for d in range(3):
            z[c] += R[d, c] * (y[d] - t[d])


@compiled()
def _columns(y: Floats, seconds: Floats, seen: Ints, j: int, R: Floats, pivot: Floats, found: Floats) -> None:
    """Derivative of R^T (y - t) at the j-th frame that is seen, [3, 7]."""
    f = seen[j]
    r0, r1, r2 = y[f, 0] - pivot[0], y[f, 1] - pivot[1], y[f, 2] - pivot[2]
    for c in range(3):
        a, b, e = R[0, c], R[1, c], R[2, c]
        found[c, 0], found[c, 1], found[c, 2] = e * r1 - b * r2, a * r2 - e * r0, b * r0 - a * r1
        found[c, 3], found[c, 4], found[c, 5] = a, b, e
        found[c, 6] = 0.0
        for d in range(3):
            found[c, 6] += R[d, c] * _slope(y, seconds, seen, j, d)


@compiled()
def _slope(y: Floats, seconds: Floats, seen: Ints, j: int, c: int) -> float:
    """Velocity by a difference of second order where there are frames on both sides, else of first order."""
    low, high = seen[max(j - 1, 0)], seen[min(j + 1, len(seen) - 1)]
    f = seen[j]
    if f in (low, high):
        return float((y[high, c] - y[low, c]) / (seconds[high] - seconds[low]))
    before, after = seconds[f] - seconds[low], seconds[high] - seconds[f]
    rise = before * before * (y[high, c] - y[f, c]) + after * after * (y[f, c] - y[low, c])
    return float(rise / (before * after * (before + after)))


@compiled()
def _add(design: Floats, z: Floats, inverse: float, left: Floats, right: Floats) -> Floats:
    """Centre a row and add its normal equations, in units of its variance.

    `design` [n, 3, 7] and `z` [n, 3] are less their means then. Returns the mean of z and the squared
    residual, float64 [4].
    """
    count = len(z)
    mean, middle = np.zeros((3, REGISTRATION_UNKNOWNS)), np.zeros(4)
    for k in range(count):
        for c in range(3):
            middle[c] += z[k, c] / count
            for p in range(REGISTRATION_UNKNOWNS):
                mean[c, p] += design[k, c, p] / count
    for k in range(count):
        for c in range(3):
            z[k, c] -= middle[c]
            r = z[k, c]
            middle[3] += r * r * inverse
            for p in range(REGISTRATION_UNKNOWNS):
                design[k, c, p] -= mean[c, p]
            for p in range(REGISTRATION_UNKNOWNS):
                a = design[k, c, p] * inverse
                right[p] -= a * r
                for q in range(REGISTRATION_UNKNOWNS):
                    left[p, q] += a * design[k, c, q]
    return middle


@compiled()
def move_rows(
    arrays: RowArrays, seconds: Floats, rows: Ints, R: Floats, t: Floats, ahead: float, out: Floats
) -> None:
    """Where rows would be under another rigid transform and delay: R (y + velocity ahead) + t.

    Parameters
    ----------
    seconds
        float64 [F], times of the frames.
    rows
        intp [n], rows to move.
    R, t, ahead
        float64 [3, 3], [3] and s.
    out
        Out: float64 [P, F, 3], of which the seen frames of `rows` are written.
    """
    y, w, _, _, _ = arrays
    seen, moved = np.empty(len(seconds), np.intp), np.empty(3)
    for i in rows:
        count = 0
        for f in range(len(seconds)):
            if w[i, f] > 0:
                seen[count] = f
                count += 1
        for j in range(count):
            f = seen[j]
            for c in range(3):
                moved[c] = y[i, f, c]
                if count > 1:
                    moved[c] += ahead * _slope(y[i], seconds, seen[:count], j, c)
            for c in range(3):
                out[i, f, c] = R[c, 0] * moved[0] + R[c, 1] * moved[1] + R[c, 2] * moved[2] + t[c]
