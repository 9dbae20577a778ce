"""Compiled: in rows and a body's poses, out equations for the source's rotation, shift and delay."""

import numpy as np

from ...arrays import Floats, Ints
from ...compiled import compiled
from .records import PoseArrays, RowArrays

COLUMNS = 7
"""Unknowns: rotation vector, shift and delay."""


@compiled()
def normal_equations(
    arrays: RowArrays,
    seconds: Floats,
    rows: Ints,
    poses: PoseArrays,
    pivot: Floats,
    least: int,
    left: Floats,
    right: Floats,
) -> tuple[float, int]:
    """Add the normal equations of rows that should be constant in the frame of one body.

    z = R^T (y - t) has the derivative R^T [omega x (y - pivot) + shift + velocity delay]. The place of a row
    in the body is unknown, so only departures from its mean count.

    Parameters
    ----------
    seconds
        float64 [F], times of the frames.
    rows
        intp [n], rows to take.
    pivot
        float64 [3], centre of the rotation.
    least
        Rows with fewer frames are left out.
    left, right
        In and out: float64 [7, 7] and [7], to which the equations are added.

    Returns
    -------
    The squared residual before the step, in units of the rows' variances, and the number of frames.
    """
    y, w, tolerance = arrays
    R, t, posed = poses
    squared, frames = 0.0, 0
    seen = np.empty(len(seconds), np.intp)
    design, z = np.empty((len(seconds), 3, COLUMNS)), np.empty((len(seconds), 3))
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
            for c in range(3):
                z[j, c] = 0.0
                for d in range(3):
                    z[j, c] += R[f, d, c] * (y[i, f, d] - t[f, d])
        squared += _add(design[:count], z[:count], 1.0 / tolerance[i], left, right)
        frames += count
    return squared, frames


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
def _add(design: Floats, z: Floats, inverse: float, left: Floats, right: Floats) -> float:
    """Add the centred normal equations of a row, in units of its variance; return its squared residual."""
    count = len(z)
    squared = 0.0
    mean, middle = np.zeros((3, COLUMNS)), np.zeros(3)
    for k in range(count):
        for c in range(3):
            middle[c] += z[k, c] / count
            for p in range(COLUMNS):
                mean[c, p] += design[k, c, p] / count
    for k in range(count):
        for c in range(3):
            r = z[k, c] - middle[c]
            squared += r * r
            for p in range(COLUMNS):
                a = (design[k, c, p] - mean[c, p]) * inverse
                right[p] -= a * r
                for q in range(COLUMNS):
                    left[p, q] += a * (design[k, c, q] - mean[c, q])
    return squared * inverse
