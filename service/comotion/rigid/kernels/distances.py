"""Compiled: deviations of the distances of pairs of rows, and points that are far from one another."""

import numpy as np

from ...arrays import Floats, Ints
from ...compiled import compiled
from ...geometry.records import quadratic


@compiled()
def distance_deviation(y: Floats, w: Floats, covariance: Floats) -> Floats:
    """Standard deviation of each pair's distance over its common frames: the root of (3.3), equal weights.

    It is relative to that of the noise along the line between the two.

    Parameters
    ----------
    y, w, covariance
        float64 [n, F, 3], [n, F] (0: unobserved) and [n, 6], of the noise: xx, xy, xz, yy, yz, zz.

    Returns
    -------
    float64 [n, n], symmetric; NaN where a pair shares fewer than two frames, and on the diagonal.
    """
    n, frames = w.shape
    deviation = np.full((n, n), np.nan)
    for i in range(n):
        for j in range(i + 1, n):
            noise, count, shift, total, squares = covariance[i] + covariance[j], 0, 0.0, 0.0, 0.0
            along, length = 0.0, 0.0
            for f in range(frames):
                if w[i, f] > 0 and w[j, f] > 0:
                    a, b, c = y[i, f, 0] - y[j, f, 0], y[i, f, 1] - y[j, f, 1], y[i, f, 2] - y[j, f, 2]
                    d2 = a * a + b * b + c * c
                    d = np.sqrt(d2)
                    along += quadratic(noise, a, b, c)
                    length += d2
                    # Sums about the first distance, as E[d^2] - E[d]^2 would cancel.
                    shift = d if count == 0 else shift
                    total += d - shift
                    squares += (d - shift) ** 2
                    count += 1
            if count > 1:
                variance = max(squares - total * total / count, 0.0) / (count - 1)
                # The mean over the frames: the pair may turn.
                deviation[i, j] = deviation[j, i] = np.sqrt(variance * length / max(along, 1e-300))
    return deviation


@compiled()
def farthest_points(x: Floats, count: int) -> Ints:
    """Indices of `count` of the points x [n, 3]: the first, then always the farthest from those before."""
    farthest = np.zeros(count, np.intp)
    nearest = np.full(len(x), np.inf)
    for k in range(1, count):
        best, last = 0, farthest[k - 1]
        for i in range(len(x)):
            squared = (x[i, 0] - x[last, 0]) ** 2 + (x[i, 1] - x[last, 1]) ** 2 + (x[i, 2] - x[last, 2]) ** 2
            nearest[i] = min(nearest[i], squared)
            if nearest[i] > nearest[best]:
                best = i
        farthest[k] = best
    return farthest
